"""On-board detector of the simulated car: boxes with velocities and ids, and their usual errors.

Boxes are those of the truth with noise of place, size, heading and velocity. Objects of few points
are missed. A tracker reports an object after some frames only, coasts over short misses, and gives
a lost object another id. Ghosts appear on structure for less than half a second. Planted failures
act on the boxes as they act on the labels of points (`faults.py`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.lab.simulation.faults.faults import STATIC, PlantedFailure
from workers.lab.simulation.faults.plan import FailureKind
from workers.lab.simulation.models.kinds import StreetClass
from workers.lab.simulation.sensor.lidar import SimulatedFrame
from workers.lab.simulation.world.street import Street

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

_PLACE_M: Final = 0.06
_PLACE_PER_M: Final = 0.003
"""Standard deviation of a box's place: metres, and its growth per metre of range."""

_SIZE_SHARE: Final = 0.05
_HEADING_RAD: Final = 0.035
_REVERSED_SHARE: Final = 0.01
"""Share of the boxes whose front and back are mistaken."""

_SPEED_M_PER_S: Final = 0.2
_STANDING_M_PER_S: Final = 0.08
"""Standard deviation of each component of the velocity, of movers and of standing objects."""

_GHOSTS_PER_FRAME: Final = 0.04
_GHOST_FRAMES: Final = (1, 4)
_GHOST_SIZE_M: Final = (4.2, 1.8, 1.6)
_GHOST_M_PER_S: Final = 1.2
_WRONG_M_PER_S: Final = (1.5, 5.0)
"""Speed of a box that stands and is reported as moving."""

_NO_BOX: Final = frozenset(
    {
        FailureKind.UNSEEN_CLASS,
        FailureKind.MISSED_PEDESTRIAN,
        FailureKind.LATE_DETECTION,
        FailureKind.FLICKER,
    }
)
"""Failures by which an object has no box; other missed movers have a box that stands."""


@dataclass(frozen=True, slots=True)
class DetectedBox:
    """One box of a detector in one frame.

    Attributes:
        class_name: Class, by its name in the metadata record `counterpoint.classes`.
        centre_m: Centre of the box, sensor space at the time of the frame.
        yaw_rad: Heading around the sensor's z axis.
        size_m: Length, width and height.
        velocity_m_per_s: Velocity over the ground along the sensor's x and y axes.
        track_id: Id of the object, the same as long as the tracker follows it.
        score: Confidence, 0 to 1.
    """

    class_name: str
    centre_m: tuple[float, float, float]
    yaw_rad: float
    size_m: tuple[float, float, float]
    velocity_m_per_s: tuple[float, float]
    track_id: int
    score: float


@dataclass(slots=True)
class _Followed:
    """State of the tracker on one object."""

    track_id: int
    confirm: int
    seen: int = 0
    missed: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """An object in world space: centre, heading, size and velocity."""

    class_name: str
    centre_m: NDArray[np.float64]
    yaw_rad: float
    size_m: NDArray[np.float64]
    velocity: NDArray[np.float64]


class Detector:
    """Detector and tracker of one drive; frames are given in order, from the first one."""

    def __init__(self, street: Street) -> None:
        self._street = street
        self._followed: dict[int, _Followed] = {}
        self._ghosts: list[tuple[_Body, int, int]] = []
        self._next_id = 1
        own = np.random.default_rng([street.seed, 0xB0C5])
        self._bias = own.normal(0.0, _SIZE_SHARE, (len(street.actors), 3)).clip(-0.15, 0.15)

    def detect(
        self, frame: SimulatedFrame, failures: Sequence[PlantedFailure]
    ) -> tuple[DetectedBox, ...]:
        """Return the boxes of the next frame.

        Args:
            frame: The frame as measured.
            failures: Failures planted in the log.
        """
        rng = np.random.default_rng([self._street.seed, 0xDE7EC7, frame.index])
        active = [each for each in failures if each.is_on(frame.time_s)]
        boxes = [*self._objects(frame, active, rng)]
        boxes += self._flashes(frame, rng)
        boxes += self._planted_ghosts(frame, active, rng)
        return tuple(boxes)

    def _objects(
        self, frame: SimulatedFrame, active: Sequence[PlantedFailure], rng: np.random.Generator
    ) -> Iterator[DetectedBox]:
        inside = np.bincount(frame.track[frame.track >= 0], minlength=len(self._street.actors))
        bodies = self._street.actor_bodies(frame.time_s)
        velocities = self._street.actor_velocities(frame.time_s)
        draws = rng.random((len(inside), 3))
        noise = rng.standard_normal((len(inside), 9))
        for track, actor in enumerate(self._street.actors):
            x, y, z, yaw, _, _ = bodies[track]
            size = np.array(actor.size_m)
            body = _Body(
                actor.street_class.name.lower(),
                np.array([x, y, z + size[2] / 2]),
                float(yaw),
                size,
                velocities[track],
            )
            changed = _with_failures(track, body, frame, active, moves=_moves(frame, track))
            followed = self._follow(track, int(inside[track]), draws[track])
            if followed is None or changed is None:
                continue
            noisy = _with_noise(changed, self._bias[track], frame, noise[track], draws[track, 2])
            sure = 1.0 - np.exp(-inside[track] / 40.0)
            score = float(np.clip(0.35 + 0.6 * sure + 0.04 * noise[track, 8], 0.05, 0.99))
            yield _box(noisy, frame, followed.track_id, score)

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
            state = _Followed(self._new_id(), least + int(draw[1] * (most - least)))
            self._followed[track] = state
        elif draw[1] < _SWITCH_SHARE:
            state.track_id = self._new_id()
        state.seen, state.missed = state.seen + 1, 0
        return state if state.seen >= state.confirm else None

    def _new_id(self) -> int:
        self._next_id += 1
        return self._next_id - 1

    def _flashes(self, frame: SimulatedFrame, rng: np.random.Generator) -> Iterator[DetectedBox]:
        """Yield ghosts that appear on structure for a few frames, with low scores."""
        standing = np.flatnonzero((frame.track < 0) & (frame.ground == 0) & (frame.motion == 1))
        self._ghosts = [each for each in self._ghosts if each[2] > frame.index]
        if len(standing) and rng.random() < _GHOSTS_PER_FRAME:
            point = frame.points_m[int(rng.choice(standing))].astype(np.float64)
            pose = frame.world_from_sensor
            body = _Body(
                StreetClass.CAR.name.lower(),
                pose[:3, :3] @ point + pose[:3, 3],
                float(rng.uniform(-np.pi, np.pi)),
                np.array(_GHOST_SIZE_M),
                rng.normal(0.0, _GHOST_M_PER_S, 2),
            )
            until = frame.index + int(rng.integers(*_GHOST_FRAMES, endpoint=True))
            self._ghosts.append((body, self._new_id(), until))
        for body, track_id, _ in self._ghosts:
            yield _box(body, frame, track_id, float(rng.uniform(0.1, 0.45)))

    def _planted_ghosts(
        self, frame: SimulatedFrame, active: Sequence[PlantedFailure], rng: np.random.Generator
    ) -> Iterator[DetectedBox]:
        for each in active:
            if each.kind is FailureKind.GHOST_MOVER and each.place_m is not None and each.track < 0:
                own = np.random.default_rng([self._street.seed, round(each.start_s * 1000)])
                yaw = float(own.uniform(-np.pi, np.pi))
                pace = float(own.uniform(*_WRONG_M_PER_S))
                if any(each.slides_m_per_s):
                    yaw = float(np.arctan2(each.slides_m_per_s[1], each.slides_m_per_s[0]))
                wide = np.array([max(2 * each.radius_m, 2.0), 2 * each.radius_m, 1.8])
                body = _Body(
                    StreetClass.CAR.name.lower(),
                    each.ghost_place_m(frame.time_s),
                    yaw,
                    wide,
                    pace * np.array([np.cos(yaw), np.sin(yaw)]),
                )
                number = 1_000_000 + round(each.start_s * 1000)
                yield _box(body, frame, number, float(rng.uniform(0.4, 0.9)))


def _moves(frame: SimulatedFrame, track: int) -> bool:
    mine = frame.track == track
    return bool(mine.any()) and bool((frame.motion[mine] != STATIC).mean() > 0.5)


def _with_failures(
    track: int,
    body: _Body,
    frame: SimulatedFrame,
    active: Sequence[PlantedFailure],
    *,
    moves: bool,
) -> _Body | None:
    """Change a box by the failures on its object; None where there is no box."""
    for each in active:
        ahead = np.array([np.cos(body.yaw_rad), np.sin(body.yaw_rad)])
        invented = (_WRONG_M_PER_S[0] + track % 7 / 2) * ahead
        if each.kind is FailureKind.RANGE_LIMIT:
            away = body.centre_m[:2] - frame.world_from_sensor[:2, 3]
            if moves and np.hypot(*away) > each.range_m:
                return None
        elif track == each.other_track:
            body = replace(body, velocity=invented)
        elif track != each.track:
            continue
        elif each.kind in (FailureKind.PARKED_CALLED_MOVING, FailureKind.GHOST_MOVER):
            body = replace(body, velocity=invented)
        elif each.kind in _NO_BOX:
            return None
        elif each.kind is FailureKind.HALF_LABELLED:
            rest = 1.0 - each.part_share
            front = np.array([np.cos(each.heading_rad), np.sin(each.heading_rad), 0.0])
            body = replace(
                body,
                centre_m=body.centre_m + front * (body.size_m[0] * each.part_share / 2),
                size_m=body.size_m * [rest, 1.0, 1.0],
            )
        else:
            body = replace(body, velocity=np.zeros(2))
    return body


def _with_noise(
    body: _Body,
    bias: NDArray[np.float64],
    frame: SimulatedFrame,
    noise: NDArray[np.float64],
    draw: float,
) -> _Body:
    range_m = float(np.hypot(*(body.centre_m - frame.world_from_sensor[:3, 3])[:2]))
    place = (_PLACE_M + _PLACE_PER_M * range_m) * noise[:3] * [1.0, 1.0, 0.5]
    speed = float(np.hypot(*body.velocity))
    spread = _SPEED_M_PER_S if speed > 0.2 else _STANDING_M_PER_S
    turned = np.pi if draw < _REVERSED_SHARE else 0.0
    return _Body(
        body.class_name,
        body.centre_m + place,
        body.yaw_rad + _HEADING_RAD * float(noise[3]) + turned,
        body.size_m * (1.0 + bias + 0.02 * noise[4]),
        body.velocity + spread * noise[5:7],
    )


def _box(body: _Body, frame: SimulatedFrame, track_id: int, score: float) -> DetectedBox:
    """Turn an object into sensor space."""
    rotation, origin = frame.world_from_sensor[:3, :3], frame.world_from_sensor[:3, 3]
    x, y, z = ((body.centre_m - origin) @ rotation).round(3).tolist()
    heading = rotation.T @ np.array([np.cos(body.yaw_rad), np.sin(body.yaw_rad), 0.0])
    vx, vy = (rotation.T @ np.array([*body.velocity, 0.0]))[:2].round(3).tolist()
    length, width, height = body.size_m.round(3).tolist()
    return DetectedBox(
        body.class_name,
        (x, y, z),
        round(float(np.arctan2(heading[1], heading[0])), 4),
        (length, width, height),
        (vx, vy),
        track_id,
        round(score, 3),
    )
