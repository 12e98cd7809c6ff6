"""Keyframes: the points off the ground every half second, to which shapes are compared."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Points, Transform
from schemas.contradiction import LabelledFrame, Scene
from workers.contradiction.occlusion import RangeBounds, occluded_share, range_bounds_of
from workers.contradiction.shape_matching import Cells, Tiles, cells_in_box, tiled
from workers.contradiction.temporal_context import frames_with_context
from workers.points.point_kernels import moved_rows, returns_within
from workers.points.se3 import inverse

EVERY_S: Final = 0.45
"""Least time between keyframes, seconds: half a second at 10 Hz, with or without jitter."""

OCCLUDER_MARGIN_M: Final = 0.5
"""Least distance of an occluder in front of an object, metres: the resolution of free space."""

_FARTHEST: Final = np.float32(1000.0)


class Keyframes:
    """Points off the ground every half second, from a second before a scene to a second after."""

    def __init__(self, scene: Scene) -> None:
        """Choose the frames; each is sorted when it is first queried."""
        self._frames: list[LabelledFrame] = []
        for frame in frames_with_context(scene):
            due_ns = self._frames[-1].stamp_ns + round(EVERY_S * NS_PER_S) if self._frames else 0
            if frame.stamp_ns >= due_ns:
                self._frames.append(frame)
        self.stamps_ns = np.array([frame.stamp_ns for frame in self._frames], np.int64)
        self._tiles: dict[int, Tiles] = {}
        self._bounds: dict[int, tuple[Transform, RangeBounds]] = {}

    def near(self, number: int, low_m: NDArray[np.float64], high_m: NDArray[np.float64]) -> Cells:
        """Sort the places of one keyframe within bounds into cells over the ground.

        Args:
            number: Index of the keyframe.
            low_m: (3,) lower bounds, odom space.
            high_m: (3,) upper bounds, odom space.
        """
        if number not in self._tiles:
            self._tiles[number] = tiled(_off_ground(self._frames[number]))
        return cells_in_box(self._tiles[number], low_m, high_m)

    def occluded_share(self, number: int, places_m: NDArray[np.float64]) -> float:
        """Return the occluded share of places (P, 3), odom space, in one keyframe."""
        if number not in self._bounds:
            posed = self._frames[number].posed
            self._bounds[number] = inverse(posed.odom_from_sensor), _bounds(self._frames[number])
        return occluded_share(places_m, *self._bounds[number], OCCLUDER_MARGIN_M)


def _bounds(frame: LabelledFrame) -> RangeBounds:
    points_m = frame.posed.frame.points_m
    index = returns_within(points_m, frame.posed.frame.valid_mask, _FARTHEST)
    ground = frame.predictive.ground_mask
    return range_bounds_of(
        points_m, index, np.zeros(len(points_m), bool) if ground is None else ground
    )


def _off_ground(frame: LabelledFrame) -> Points:
    """Return the points (M, 3) of a frame that are off the ground, odom space."""
    points_m = frame.posed.frame.points_m
    index = returns_within(points_m, frame.posed.frame.valid_mask, _FARTHEST)
    if frame.predictive.ground_mask is not None:
        index = index[~frame.predictive.ground_mask[index]]
    return moved_rows(points_m, index, frame.posed.odom_from_sensor)
