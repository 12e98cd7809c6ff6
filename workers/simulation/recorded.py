"""The model that ran on the simulated car: the truth, but for mistakes that were planted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.simulation.kinds import MOVABLE, StreetClass
from workers.simulation.lidar import Lidar, SimulatedFrame, sweep
from workers.simulation.street import Street

STATIC: Final = 1
DYNAMIC: Final = 2

_RIGHT_BETA: Final = (18.0, 2.0)
_WRONG_BETA: Final = (8.0, 3.0)
"""Confidence of right and wrong labels, one draw per thing and frame: wrong ones are less sure."""


_FIRST_S: Final = 2.0
_SEEN_WELL_M: Final = 45.0
_ENOUGH_POINTS: Final = 400.0
_FEW_POINTS: Final = 4.0


class MistakeKind(StrEnum):
    """What the model on the car gets wrong about one track."""

    MISSED_MOVER = "missed_mover"
    PARKED_CALLED_MOVING = "parked_called_moving"
    MISSED_PEDESTRIAN = "missed_pedestrian"


@dataclass(frozen=True, slots=True)
class Mistake:
    """One wrong answer about one track, for a while.

    Attributes:
        kind: What goes wrong.
        track: Index into the street's actors.
        start_s: Seconds from the start of the log.
        end_s: First instant after it.
    """

    kind: MistakeKind
    track: int
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True, eq=False)
class RecordedPoints:
    """What the model said about each point of one frame, as it is written to the log.

    Attributes:
        label: (N,) class id.
        motion: (N,) 0 unknown, 1 static, 2 dynamic.
        confidence: (N,) 0 to 1.
    """

    label: NDArray[np.uint16]
    motion: NDArray[np.uint8]
    confidence: NDArray[np.float32]


def record(street: Street, frame: SimulatedFrame, mistakes: Sequence[Mistake]) -> RecordedPoints:
    """Say what the model on the car made of a frame."""
    motion = frame.motion.copy()
    label = frame.class_id.astype(np.uint16)
    for mistake in mistakes:
        if mistake.start_s <= frame.time_s < mistake.end_s:
            mine = frame.track == mistake.track
            if mistake.kind is MistakeKind.PARKED_CALLED_MOVING:
                motion[mine] = DYNAMIC
            else:
                motion[mine] = STATIC
            if mistake.kind is MistakeKind.MISSED_PEDESTRIAN:
                label[mine] = StreetClass.OBJECT
    wrong = motion != frame.motion
    rng = np.random.default_rng([street.seed, frame.index, 0xC0F])
    things = len(street.actors) + 1 + max(StreetClass)
    thing = np.where(frame.track >= 0, frame.track, len(street.actors) + frame.class_id)
    right_sure, wrong_sure = rng.beta(*_RIGHT_BETA, things), rng.beta(*_WRONG_BETA, things)
    confidence = np.where(wrong, wrong_sure[thing], right_sure[thing]).round(2)
    return RecordedPoints(label, motion, confidence.astype(np.float32))


def recorded_classes() -> dict[str, str]:
    """Content of the metadata record `counterpoint.classes`: id to JSON."""
    return {
        str(int(c)): f'{{"name": "{c.name.lower()}", "movable": {str(c in MOVABLE).lower()}, '
        '"moving": false}'
        for c in StreetClass
    }


def plan_mistakes(
    street: Street,
    *,
    lidar: Lidar,
    kinds: Sequence[MistakeKind] = tuple(MistakeKind),
    lasting_s: float = 4.0,
) -> tuple[Mistake, ...]:
    """Choose one mistake of each of these kinds, about tracks that the lidar sees well at the time.

    A coarse lidar looks twice a second; per kind the track and window with the most returns win,
    so the choice depends on the street alone. The first seconds stay right: the streams warm up.
    """
    step_s = 0.5
    every = round(step_s / lidar.period_s)
    coarse = replace(lidar, columns=256, max_range_m=_SEEN_WELL_M)
    actors = len(street.actors)
    looks = int(street.seconds / step_s)
    seen = np.zeros((looks, actors))
    moves = np.zeros((looks, actors), dtype=np.bool_)
    for look in range(looks):
        frame = sweep(street, coarse, look * every)
        on_actor = frame.track >= 0
        seen[look] = np.bincount(frame.track[on_actor], minlength=actors)
        moves[look, frame.track[on_actor & (frame.motion == DYNAMIC)]] = True
    seen[: round(_FIRST_S / step_s)] = 0.0
    walks = np.array([a.street_class is StreetClass.PEDESTRIAN for a in street.actors])
    parked = np.array([a.parked for a in street.actors])
    whole_log = (0.0, street.seconds + 1.0)
    planned = []
    usable = {
        MistakeKind.MISSED_MOVER: moves & ~walks,
        MistakeKind.PARKED_CALLED_MOVING: (seen > 0) & parked,
        MistakeKind.MISSED_PEDESTRIAN: moves & walks,
    }
    span = min(max(round(lasting_s / step_s), 1), max(looks, 1))
    for kind in kinds:
        found = _best_window(np.where(usable[kind], np.minimum(seen, _ENOUGH_POINTS), 0.0), span)
        if found is None:
            continue
        track, first = found
        window = (first * step_s, (first + span) * step_s)
        never_seen = kind is MistakeKind.MISSED_PEDESTRIAN
        planned.append(Mistake(kind, track, *(whole_log if never_seen else window)))
    return tuple(planned)


def _best_window(points: NDArray[np.float64], span: int) -> tuple[int, int] | None:
    """Find the (track, first look) whose `span` looks hold most points; None when there are few."""
    if not points.size:
        return None
    sums = np.lib.stride_tricks.sliding_window_view(points, span, axis=0).sum(axis=-1)
    first, track = np.unravel_index(int(np.argmax(sums)), sums.shape)
    return (int(track), int(first)) if sums[first, track] >= _FEW_POINTS * span else None
