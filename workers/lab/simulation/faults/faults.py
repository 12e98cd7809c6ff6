"""Planted failures: wrong labels of the on-board model on one object, for a limited time."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform
from workers.lab.simulation.faults.plan import FailureKind
from workers.lab.simulation.models.kinds import StreetClass

STATIC: Final = 1
DYNAMIC: Final = 2

GHOST_RADIUS_M: Final = 1.2

_FLICKER_S: Final = 0.3
"""Duration of the wrong labels, seconds; right labels follow for half of it."""


class TrueFrame(Protocol):
    """A frame with the truth of each point, simulated or recorded."""

    @property
    def index(self) -> int:
        """Number of the frame in its log."""
        ...

    @property
    def time_s(self) -> float:
        """Seconds from the start of the log."""
        ...

    @property
    def points_m(self) -> Points:
        """(N, 3) points in sensor space."""
        ...

    @property
    def class_id(self) -> NDArray[np.uint8]:
        """(N,) `StreetClass`."""
        ...

    @property
    def track(self) -> NDArray[np.int16]:
        """(N,) number of the object, -1 none."""
        ...

    @property
    def motion(self) -> NDArray[np.uint8]:
        """(N,) 0 unknown, 1 static, 2 dynamic."""
        ...

    @property
    def ground(self) -> NDArray[np.uint8]:
        """(N,) 1 ground, 0 not, 255 ignored."""
        ...

    @property
    def world_from_sensor(self) -> Transform:
        """(4, 4) pose of the sensor."""
        ...


@dataclass(frozen=True, slots=True)
class PlantedFailure:
    """Wrong labels on one track, for a limited time.

    Attributes:
        kind: Kind of the failure.
        track: Index into the street's actors; -1 for a ghost, which is a place.
        start_s: Seconds from the start of the log.
        end_s: First instant after it.
        other_track: Partner in a label swap; -1 none.
        place_m: Position of a ghost as it begins, world space.
        range_m: Range beyond which movers are labelled static; 0 no limit.
        cell: Scene of the log in the plan; -1 none.
        common_mode: Whether it was chosen so that the self-supervised stream tends to fail too.
        because: Reason for common mode; empty without one.
        class_name: True class of the object.
        radius_m: Radius of a ghost.
        slides_m_per_s: Velocity of a ghost's label along what stands, x and y in world space.
        part: Share of the object's points that get the wrong label, from one of its ends on.
    """

    kind: FailureKind
    track: int
    start_s: float
    end_s: float
    other_track: int = -1
    place_m: tuple[float, float, float] | None = None
    range_m: float = 0.0
    cell: int = -1
    common_mode: bool = False
    because: str = ""
    class_name: str = ""
    part: float = 1.0
    radius_m: float = GHOST_RADIUS_M
    slides_m_per_s: tuple[float, float] = (0.0, 0.0)

    def is_on(self, time_s: float) -> bool:
        """Test that the labels are wrong at a time; a flicker has right labels in between."""
        if not self.start_s <= time_s < self.end_s:
            return False
        since_s = time_s - self.start_s + 1e-6
        return self.kind is not FailureKind.FLICKER or since_s % (1.5 * _FLICKER_S) < _FLICKER_S

    def ghost_place_m(self, time_s: float) -> NDArray[np.float64]:
        """Return the position of a ghost at a time, world space; it needs `place_m`."""
        since_s = time_s - self.start_s
        slid = np.array([*self.slides_m_per_s, 0.0]) * since_s
        return np.array(self.place_m, dtype=np.float64) + slid


def corrupt(
    frame: TrueFrame,
    motion: NDArray[np.uint8],
    label: NDArray[np.uint16],
    failures: Iterable[PlantedFailure],
) -> None:
    """Overwrite the right labels of a frame with the wrong ones of its failures.

    Args:
        frame: The frame as measured.
        motion: (N,) motion labels of the model, changed in place.
        label: (N,) class labels of the model, changed in place.
        failures: Failures of the log.
    """
    for each in failures:
        if each.is_on(frame.time_s):
            _corrupt(frame, motion, label, each)


def ghost_points(
    frame: TrueFrame,
    place_m: Sequence[float] | NDArray[np.float64],
    *,
    radius_m: float = GHOST_RADIUS_M,
    track: int = -1,
) -> Mask:
    """Find the points around a place that stand, off the ground.

    Args:
        frame: The frame.
        place_m: The place, world space.
        radius_m: Radius around it.
        track: Parked object that the ghost is on too; -1 on none, the static structure alone.
    """
    rotation, origin = frame.world_from_sensor[:3, :3], frame.world_from_sensor[:3, 3]
    in_sensor = (np.asarray(place_m) - origin) @ rotation
    away_m = frame.points_m - in_sensor.astype(np.float32)
    near = (away_m**2).sum(axis=1) < radius_m**2
    owned = (frame.track < 0) | (frame.track == track)
    mine: Mask = near & owned & (frame.ground == 0) & (frame.motion == STATIC)
    return mine


def _corrupt(
    frame: TrueFrame,
    motion: NDArray[np.uint8],
    label: NDArray[np.uint16],
    failure: PlantedFailure,
) -> None:
    kind = failure.kind
    mine = frame.track == failure.track
    if failure.part < 1.0:
        mine = _end_of(frame, mine, failure.part)
    if kind is FailureKind.GHOST_MOVER and failure.place_m is not None:
        place_m = failure.ghost_place_m(frame.time_s)
        ghost = ghost_points(frame, place_m, radius_m=failure.radius_m, track=failure.track)
        motion[ghost], label[ghost] = DYNAMIC, StreetClass.CAR
    elif kind is FailureKind.GHOST_MOVER:
        motion[mine], label[mine] = DYNAMIC, StreetClass.CAR
    elif kind is FailureKind.PARKED_CALLED_MOVING:
        motion[mine] = DYNAMIC
    elif kind is FailureKind.FLICKER:
        right = frame.motion[mine]
        motion[mine] = np.where(right == DYNAMIC, STATIC, DYNAMIC)
    elif kind is FailureKind.LABEL_SWAP:
        motion[mine] = STATIC
        motion[frame.track == failure.other_track] = DYNAMIC
    elif kind is FailureKind.RANGE_LIMIT:
        far = np.hypot(frame.points_m[:, 0], frame.points_m[:, 1]) > failure.range_m
        motion[far & (frame.motion == DYNAMIC)] = STATIC
    else:
        motion[mine] = STATIC
    if kind in (FailureKind.UNSEEN_CLASS, FailureKind.MISSED_PEDESTRIAN):
        label[mine] = StreetClass.OBJECT


def _end_of(frame: TrueFrame, mine: Mask, part: float) -> Mask:
    """Return this share of an object's points: those nearest to one end, the same in all frames."""
    index = np.flatnonzero(mine)
    if len(index) < 2:
        return mine
    places = frame.points_m[index] @ frame.world_from_sensor[:3, :3].T
    away = places[:, :2] - places[:, :2].mean(axis=0)
    _, axes = np.linalg.eigh(away.T @ away)
    long = axes[:, -1] * np.sign(axes[:, -1] @ NORTH_EAST)
    along = away @ long
    end = np.zeros_like(mine)
    end[index[along <= np.quantile(along, part)]] = True
    return end


NORTH_EAST: Final = np.array([0.8, 0.6])
"""Direction in the world that distinguishes the ends of an object."""
