"""Truth of points from the boxes of a data set: motion, track, and class where boxes give it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Mask, Transform

UNKNOWN: Final = 0
STATIC: Final = 1
DYNAMIC: Final = 2

MOVING_M_PER_S: Final = 0.5
"""Speed from which an object is dynamic, m/s; Argoverse 2's scene flow has the same limit."""

CREEPING_M_PER_S: Final = 0.2
"""Speed from which the motion of an object is unknown, m/s: boxes are not placed better."""

MARGIN_M: Final = 0.2
"""Margin around a moving box in which motion is unknown, metres: boxes are drawn tightly."""

FIT_FRAMES: Final = 3
"""Frames before and after, over which the positions of a track are fitted by a line."""

MAX_TRACKS: Final = 32_767
"""Tracks of one log: ids are int16."""


@dataclass(frozen=True, slots=True)
class TrackRow:
    """One row of `tracks.csv`: an object in one frame, lengths in metres, speeds in m/s."""

    track: int
    name: str
    uuid: str = ""
    movable: bool = True
    x: float | None = None
    y: float | None = None
    z: float | None = None
    length: float | None = None
    width: float | None = None
    height: float | None = None
    yaw: float | None = None
    velocity: tuple[float, float, float] | None = None
    points_inside: int | None = None

    @property
    def speed(self) -> float | None:
        """Speed over the ground, m/s."""
        return None if self.velocity is None else float(np.hypot(*self.velocity[:2]))


@dataclass(frozen=True, slots=True, eq=False)
class SourceBox:
    """A box of a data set in one frame.

    Attributes:
        uuid: The data set's name of the object; equal in all frames.
        name: Class.
        class_id: Id of that class.
        movable: Whether the class can move.
        world_from_box: (4, 4) centre and attitude, x along its length.
        size_m: Length, width, height.
        velocity: Over the ground in world space, m/s; None where it cannot be known.
    """

    uuid: str
    name: str
    class_id: int
    movable: bool
    world_from_box: Transform
    size_m: tuple[float, float, float]
    velocity: NDArray[np.float64] | None = None

    @property
    def speed(self) -> float | None:
        """Speed over the ground, m/s."""
        return None if self.velocity is None else float(np.hypot(*self.velocity[:2]))


@dataclass(slots=True)
class TrackNumbers:
    """Numbers of tracks, 0 and up, in the order of their first frame."""

    _of: dict[str, int] = field(default_factory=dict)

    def of(self, uuid: str) -> int:
        """Return the number of an object; -1 beyond the largest that truth can write."""
        number = self._of.setdefault(uuid, len(self._of))
        return number if number <= MAX_TRACKS else -1


def with_velocities(
    frames: Sequence[Sequence[SourceBox]], times_ns: Sequence[int], *, around: int = FIT_FRAMES
) -> list[list[SourceBox]]:
    """Fit the velocity of each track by a line over the frames around each frame.

    Args:
        frames: Boxes by frame.
        times_ns: Time of each frame.
        around: Frames before and after.

    Returns:
        The boxes, those of objects seen once without a velocity.
    """
    seen: dict[str, dict[int, SourceBox]] = {}
    for number, boxes in enumerate(frames):
        for box in boxes:
            seen.setdefault(box.uuid, {})[number] = box
    time_s = (np.asarray(times_ns, np.int64) - times_ns[0]) / NS_PER_S if times_ns else np.empty(0)
    return [
        [replace(box, velocity=_fitted(seen[box.uuid], number, time_s, around)) for box in boxes]
        for number, boxes in enumerate(frames)
    ]


def _fitted(
    track: Mapping[int, SourceBox], number: int, time_s: NDArray[np.float64], around: int
) -> NDArray[np.float64] | None:
    near = [k for k in range(number - around, number + around + 1) if k in track]
    if len(near) < 2:
        return None
    places = np.array([track[k].world_from_box[:3, 3] for k in near])
    times = time_s[near] - time_s[near].mean()
    velocity: NDArray[np.float64] = times @ (places - places.mean(axis=0)) / (times @ times)
    return velocity


@dataclass(frozen=True, slots=True, eq=False)
class BoxTruth:
    """Truth of N points from boxes: motion, track, class id of the box (0 none), and objects."""

    motion: NDArray[np.uint8]
    track: NDArray[np.int16]
    box_class: NDArray[np.uint16]
    objects: list[TrackRow]


def truth_of_boxes(
    world_m: NDArray[np.float64],
    boxes: Sequence[SourceBox],
    numbers: TrackNumbers,
    *,
    movable: Mask | None = None,
    ground: Mask | None = None,
    noise: Mask | None = None,
) -> BoxTruth:
    """Label points by the boxes they are in.

    A point in a box of a movable class that is faster than 0.5 m/s is dynamic. Unknown are points
    within 0.2 m of such a box; points in or near one that is slower than that and faster than
    0.2 m/s, or whose speed is not known; points of the ground in a moving box; points of a movable
    class in no box; and noise. All others are static.

    Args:
        world_m: (N, 3) points, world space.
        boxes: Boxes of the frame.
        numbers: Numbers of the tracks, which new ones are added to.
        movable: (N,) points whose class can move, where points have classes.
        ground: (N,) points of the ground, where points have classes.
        noise: (N,) points that are no object.
    """
    n = len(world_m)
    motion = np.full(n, STATIC, np.uint8)
    track = np.full(n, -1, np.int16)
    box_class = np.zeros(n, np.uint16)
    in_any, unknown = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    depth = np.full(n, np.inf)
    objects = []
    for box in boxes:
        half = np.asarray(box.size_m) / 2
        centre = box.world_from_box[:3, 3]
        reach = float(np.linalg.norm(half)) + MARGIN_M
        near = np.flatnonzero((np.abs(world_m[:, :2] - centre[:2]) <= reach).all(axis=1))
        local = np.abs((world_m[near] - centre) @ box.world_from_box[:3, :3])
        inside = (local <= half).all(axis=1)
        around = (local <= half + MARGIN_M).all(axis=1)
        speed = box.speed
        moving = box.movable and speed is not None and speed > MOVING_M_PER_S
        unsure = box.movable and not moving and (speed is None or speed > CREEPING_M_PER_S)
        number = numbers.of(box.uuid)
        if moving or unsure:
            unknown[near[around & ~inside]] = True
        # of several boxes, the one whose centre is nearest in units of its size has the point
        deep = np.max(local / np.maximum(half, 1e-6), axis=1)
        mine = near[inside & (deep < depth[near])]
        depth[near[inside]] = np.minimum(depth[near[inside]], deep[inside])
        in_any[mine] = True
        track[mine], box_class[mine] = number, box.class_id
        motion[mine] = DYNAMIC if moving else UNKNOWN if unsure else STATIC
        objects.append(_row(box, number, int(np.count_nonzero(inside))))
    motion[unknown & ~in_any] = UNKNOWN
    if ground is not None:
        motion[ground & (motion == DYNAMIC)] = UNKNOWN
    if movable is not None:
        motion[movable & ~in_any] = UNKNOWN
    if noise is not None:
        motion[noise] = UNKNOWN
    return BoxTruth(motion, track, box_class, objects)


def _row(box: SourceBox, number: int, points: int) -> TrackRow:
    x, y, z = (float(each) for each in box.world_from_box[:3, 3])
    ahead = box.world_from_box[:3, 0]
    velocity = None
    if box.velocity is not None:
        velocity = (float(box.velocity[0]), float(box.velocity[1]), float(box.velocity[2]))
    return TrackRow(
        track=number,
        name=box.name,
        uuid=box.uuid,
        movable=box.movable,
        x=x,
        y=y,
        z=z,
        length=box.size_m[0],
        width=box.size_m[1],
        height=box.size_m[2],
        yaw=float(np.arctan2(ahead[1], ahead[0])),
        velocity=velocity,
        points_inside=points,
    )
