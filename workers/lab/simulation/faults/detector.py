"""On-board detector of a car: boxes with velocities and ids, and their usual errors.

Boxes are those of the truth with noise of place, size, heading and velocity. Objects of few points
are missed. A tracker reports an object after some frames only, coasts over short misses, and gives
a lost object another id. Ghosts appear on structure for less than half a second. Planted failures
act on the boxes as they act on the labels of points (`faults.py`).
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.lab.simulation.faults.detected_boxes import (
    NO_BOX,
    SIZE_SHARE,
    WRONG_M_PER_S,
    Body,
    DetectedBox,
    box_of,
    with_failures,
    with_noise,
)
from workers.lab.simulation.faults.faults import STATIC, PlantedFailure, TrueFrame
from workers.lab.simulation.faults.plan import FailureKind
from workers.lab.simulation.models.kinds import StreetClass

_LEAST_POINTS: Final = 4
_HALF_MISSED_POINTS: Final = 12.0
"""Points of an object of which the detector misses 63 % in a frame."""

_MISSED_SHARE: Final = 0.02
_CONFIRM_FRAMES: Final = (2, 6)
"""Frames in a row after which the tracker reports an object."""

_COAST_FRAMES: Final = 2
"""Misses in a row over which the tracker keeps a box and its id."""

_SWITCH_SHARE: Final = 0.002
"""Chance per frame that an object gets another id without being lost."""

_RUN_FRAMES: Final = 10
"""Frames for which the tracker has run before the first one: longer than it takes to confirm."""

_GHOSTS_PER_FRAME: Final = 0.04
_GHOST_FRAMES: Final = (1, 4)
_GHOST_SIZE_M: Final = (4.2, 1.8, 1.6)
_GHOST_M_PER_S: Final = 1.2
_PLANTED_IDS: Final = 1_000_000
"""First id of planted ghosts; their start in milliseconds is added."""


@dataclass(slots=True)
class _Followed:
    """State of the tracker on one object."""

    track_id: int
    confirm: int
    seen: int = 0
    missed: int = 0


class Detector:
    """Detector and tracker of one drive; frames are given in order, from the first one.

    A log begins amid a drive. The tracker has therefore followed the objects of its first frame for
    a while, with as many points as they have there: what it misses in that frame is coasted over.

    Args:
        seed: Seed of its errors.
        things: Number of objects of the drive.
        no_box: Kinds of failure by which an object has no box.
    """

    def __init__(self, seed: int, things: int, *, no_box: Collection[FailureKind] = NO_BOX) -> None:
        self._seed = seed
        self._things = things
        self._no_box = no_box
        self._followed: dict[int, _Followed] = {}
        self._has_run = False
        self._ghosts: list[tuple[Body, int, int]] = []
        self._next_id = 1
        own = np.random.default_rng([seed, 0xB0C5])
        self._bias = own.normal(0.0, SIZE_SHARE, (things, 3)).clip(-0.15, 0.15)

    def detect(
        self,
        frame: TrueFrame,
        bodies: Mapping[int, Body],
        failures: Sequence[PlantedFailure],
    ) -> tuple[DetectedBox, ...]:
        """Return the boxes of the next frame.

        Args:
            frame: The frame as measured.
            bodies: True boxes of its objects, by number; an object without one is not detected.
            failures: Failures planted in the log.
        """
        if not self._has_run:
            self._run_before(frame, bodies)
            self._has_run = True
        rng = np.random.default_rng([self._seed, 0xDE7EC7, frame.index])
        active = [each for each in failures if each.is_on(frame.time_s)]
        boxes = [*self._objects(frame, bodies, active, rng)]
        boxes += self._flashes(frame, rng)
        boxes += self._planted_ghosts(frame, active, rng)
        return tuple(boxes)

    def _run_before(self, first: TrueFrame, bodies: Mapping[int, Body]) -> None:
        """Bring the tracker into the state in which the first frame finds it."""
        rng = np.random.default_rng([self._seed, 0xBEF0])
        inside = _points_of(first, self._things)
        for _ in range(_RUN_FRAMES):
            draws = rng.random((len(inside), 3))
            for track in sorted(bodies):
                self._follow(track, int(inside[track]), draws[track])

    def _objects(
        self,
        frame: TrueFrame,
        bodies: Mapping[int, Body],
        active: Sequence[PlantedFailure],
        rng: np.random.Generator,
    ) -> Iterator[DetectedBox]:
        inside = _points_of(frame, self._things)
        draws = rng.random((len(inside), 3))
        noise = rng.standard_normal((len(inside), 9))
        for track in range(self._things):
            body = bodies.get(track)
            if body is None:
                self._followed.pop(track, None)
                continue
            changed = with_failures(
                track, body, frame, active, moves=_moves(frame, track), no_box=self._no_box
            )
            followed = self._follow(track, int(inside[track]), draws[track])
            if followed is None or changed is None:
                continue
            noisy = with_noise(changed, self._bias[track], frame, noise[track], draws[track, 2])
            sure = 1.0 - np.exp(-inside[track] / 40.0)
            score = float(np.clip(0.35 + 0.6 * sure + 0.04 * noise[track, 8], 0.05, 0.99))
            yield box_of(noisy, frame, followed.track_id, score)

    def _follow(self, track: int, points: int, draw: NDArray[np.float64]) -> _Followed | None:
        """Update the tracker on an object; return its state where it is reported."""
        missed_share = max(float(np.exp(-points / _HALF_MISSED_POINTS)), _MISSED_SHARE)
        hit = points >= _LEAST_POINTS and draw[0] >= missed_share
        state = self._followed.get(track)
        if not hit:
            if state is None:
                return None
            state.missed += 1
            if state.missed > _COAST_FRAMES or state.seen < state.confirm or not points:
                del self._followed[track]
                return None
            return state
        if state is None:
            least, most = _CONFIRM_FRAMES
            confirm = least + int(draw[1] * (most - least))
            state = _Followed(self._new_id(), confirm)
            self._followed[track] = state
        elif draw[1] < _SWITCH_SHARE:
            state.track_id = self._new_id()
        state.seen, state.missed = state.seen + 1, 0
        return state if state.seen >= state.confirm else None

    def _new_id(self) -> int:
        self._next_id += 1
        return self._next_id - 1

    def _flashes(self, frame: TrueFrame, rng: np.random.Generator) -> Iterator[DetectedBox]:
        """Yield ghosts that appear on structure for a few frames, with low scores."""
        standing = np.flatnonzero((frame.track < 0) & (frame.ground == 0) & (frame.motion == 1))
        self._ghosts = [each for each in self._ghosts if each[2] > frame.index]
        if len(standing) and rng.random() < _GHOSTS_PER_FRAME:
            point = frame.points_m[int(rng.choice(standing))].astype(np.float64)
            pose = frame.world_from_sensor
            body = Body(
                StreetClass.CAR.name.lower(),
                pose[:3, :3] @ point + pose[:3, 3],
                float(rng.uniform(-np.pi, np.pi)),
                np.array(_GHOST_SIZE_M),
                rng.normal(0.0, _GHOST_M_PER_S, 2),
            )
            until = frame.index + int(rng.integers(*_GHOST_FRAMES, endpoint=True))
            self._ghosts.append((body, self._new_id(), until))
        for body, track_id, _ in self._ghosts:
            yield box_of(body, frame, track_id, float(rng.uniform(0.1, 0.45)))

    def _planted_ghosts(
        self, frame: TrueFrame, active: Sequence[PlantedFailure], rng: np.random.Generator
    ) -> Iterator[DetectedBox]:
        for each in active:
            if each.kind is FailureKind.GHOST_MOVER and each.place_m is not None and each.track < 0:
                own = np.random.default_rng([self._seed, round(each.start_s * 1000)])
                yaw = float(own.uniform(-np.pi, np.pi))
                pace = float(own.uniform(*WRONG_M_PER_S))
                if any(each.slides_m_per_s):
                    yaw = float(np.arctan2(each.slides_m_per_s[1], each.slides_m_per_s[0]))
                wide = np.array([max(2 * each.radius_m, 2.0), 2 * each.radius_m, 1.8])
                body = Body(
                    StreetClass.CAR.name.lower(),
                    each.ghost_place_m(frame.time_s),
                    yaw,
                    wide,
                    pace * np.array([np.cos(yaw), np.sin(yaw)]),
                )
                number = _PLANTED_IDS + round(each.start_s * 1000)
                yield box_of(body, frame, number, float(rng.uniform(0.4, 0.9)))


def _points_of(frame: TrueFrame, things: int) -> NDArray[np.int64]:
    """Return the points of each object, (things,)."""
    return np.bincount(frame.track[frame.track >= 0], minlength=things)


def _moves(frame: TrueFrame, track: int) -> bool:
    mine = frame.track == track
    return bool(mine.any()) and bool((frame.motion[mine] != STATIC).mean() > 0.5)
