"""History of the last second of frames, selected by time and never by count."""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Transform
from workers.lidar.lidar_views import LidarView
from workers.points.neighbours import build_grid
from workers.points.point_grid import PointGrid
from workers.points.se3 import inverse, transform

LOOKBACK_S: Final = 1.0
VOTE_AGES_S: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
NEAR_AGE_S: Final = 0.1
FAR_AGE_S: Final = 0.5
MAX_GAP_NS: Final = NS_PER_S // 2
"""Longest gap in time between frames, nanoseconds: nothing is known about a longer one."""

_TOLERANCE_S: Final = 0.06
"""Half a revolution at 10 Hz and its jitter."""


@dataclass(frozen=True, slots=True, eq=False)
class PastFrame:
    """The kept part of an earlier frame.

    Attributes:
        stamp_ns: Its time.
        space: (4, 4) odom from the space of its poses and places.
        odom_from_beams: (4, 4) pose of the origin of the beams.
        beams_from_odom: (4, 4) the inverse pose.
        image: (R, C) its range image.
        grid: Its voxel centroids off the ground, odom space.
        views: What further lidars saw in it.
    """

    stamp_ns: int
    space: Transform
    odom_from_beams: Transform
    beams_from_odom: Transform
    image: NDArray[np.float32]
    grid: PointGrid
    views: tuple[LidarView, ...] = ()

    def expressed_in(self, space: Transform) -> "PastFrame":
        """Return the frame with poses and places in another space, given (4, 4) odom from it."""
        if self.space is space:
            return self
        moved = inverse(space) @ self.space
        pose = moved @ self.odom_from_beams
        grid = build_grid(transform(moved, self.grid.points_m), pose[:3, 3])
        views = tuple(view.expressed_in(inverse(moved)) for view in self.views)
        return PastFrame(self.stamp_ns, space, pose, inverse(pose), self.image, grid, views)

    def beams_from(self, space: Transform) -> Transform:
        """Return (4, 4) beams from another space, given (4, 4) odom from that space."""
        if self.space is space:
            return self.beams_from_odom
        return self.beams_from_odom @ inverse(self.space) @ space

    def views_from(self, space: Transform) -> tuple[LidarView, ...]:
        """Return the views for places in another space, given (4, 4) odom from that space."""
        if self.space is space:
            return self.views
        moved = inverse(self.space) @ space
        return tuple(view.expressed_in(moved) for view in self.views)


class History:
    """Frames of the last second; memory is bounded by time and by count."""

    def __init__(self, *, max_frames: int = 24) -> None:
        self._frames: deque[PastFrame] = deque(maxlen=max_frames)

    def clear(self) -> None:
        """Forget all frames, after a gap or when the pose is lost."""
        self._frames.clear()

    def add(self, frame: PastFrame) -> None:
        """Add a frame and forget the frames more than a second before it."""
        self._frames.append(frame)
        while self.age_s(self._frames[0], frame.stamp_ns) > LOOKBACK_S + _TOLERANCE_S:
            self._frames.popleft()

    def forget(self, stamp_ns: int) -> None:
        """Forget the frame of this stamp, if it is remembered."""
        kept = [frame for frame in self._frames if frame.stamp_ns != stamp_ns]
        self._frames = deque(kept, maxlen=self._frames.maxlen)

    def express_in(self, space: Transform) -> None:
        """Express all frames in another space, given (4, 4) odom from it."""
        expressed = [frame.expressed_in(space) for frame in self._frames]
        self._frames = deque(expressed, maxlen=self._frames.maxlen)

    @staticmethod
    def age_s(frame: PastFrame, now_ns: int) -> float:
        """Return the age of a frame, seconds."""
        return (now_ns - frame.stamp_ns) / NS_PER_S

    def span_s(self, now_ns: int) -> float:
        """Return the age of the oldest frame, seconds; 0 without frames."""
        return self.age_s(self._frames[0], now_ns) if self._frames else 0.0

    def expected_m(self, now_ns: int) -> NDArray[np.float64] | None:
        """Return (3,) the sensor's place at constant velocity; None where that is unknown."""
        return expected_m(self._frames, now_ns)

    def closest(
        self, age_s: float, now_ns: int, *, between: tuple[float, float]
    ) -> PastFrame | None:
        """Return the frame whose age is closest to the given one, if any lies between two ages."""
        return closest(self._frames, age_s, now_ns, between=between)

    def voters(self, now_ns: int) -> list[PastFrame]:
        """Return the frames that vote, spread over the last second at any sensor rate."""
        return voters(self._frames, now_ns)


def expected_m(frames: Sequence[PastFrame], now_ns: int) -> NDArray[np.float64] | None:
    """Extrapolate the sensor's place from the last two frames, (3,), odom space."""
    if len(frames) < 2:
        return None
    before, last = frames[-2], frames[-1]
    moved_m = last.odom_from_beams[:3, 3] - before.odom_from_beams[:3, 3]
    share = (now_ns - last.stamp_ns) / (last.stamp_ns - before.stamp_ns)
    expected: NDArray[np.float64] = last.odom_from_beams[:3, 3] + share * moved_m
    return expected


def closest(
    frames: Iterable[PastFrame], age_s: float, now_ns: int, *, between: tuple[float, float]
) -> PastFrame | None:
    """Return the frame closest to a distance in time, if any lies between two distances."""
    fitting = [
        (abs(apart_s - age_s), -frame.stamp_ns, frame)
        for frame in frames
        if between[0] <= (apart_s := abs(now_ns - frame.stamp_ns) / NS_PER_S) <= between[1]
    ]
    return min(fitting, key=lambda entry: entry[:2])[2] if fitting else None


def voters(frames: Iterable[PastFrame], now_ns: int) -> list[PastFrame]:
    """Return the frames that vote, all before or all after an instant; latest first."""
    known = list(frames)
    chosen = {
        frame.stamp_ns: frame
        for age_s in VOTE_AGES_S
        for frame in [
            closest(known, age_s, now_ns, between=(age_s - _TOLERANCE_S, age_s + _TOLERANCE_S))
        ]
        if frame is not None
    }
    return [chosen[stamp_ns] for stamp_ns in sorted(chosen, reverse=True)]
