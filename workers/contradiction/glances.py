"""What stands off the ground every half second: what shapes are laid over."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Points
from schemas.contradiction import LabelledFrame, Scene
from workers.contradiction.before_after import moments
from workers.visibility.laid_over import Cells, Tiles, cells_in_box, tiled
from workers.visibility.passes import moved_rows, returns_within

EVERY_S: Final = 0.45
"""Between the frames that are asked: half a second at 10 Hz, jitter or not."""

_FARTHEST: Final = np.float32(1000.0)


class Glances:
    """What stands off the ground every half second of a scene, and right before and after it."""

    def __init__(self, scene: Scene) -> None:
        """Choose the frames; none is laid out before it is asked."""
        self._frames: list[LabelledFrame] = []
        for frame in moments(scene):
            due_ns = self._frames[-1].stamp_ns + round(EVERY_S * NS_PER_S) if self._frames else 0
            if frame.stamp_ns >= due_ns:
                self._frames.append(frame)
        self.stamps_ns = np.array([frame.stamp_ns for frame in self._frames], np.int64)
        self._tiles: dict[int, Tiles] = {}

    def near(self, number: int, low_m: NDArray[np.float64], high_m: NDArray[np.float64]) -> Cells:
        """Sort the places of one frame within bounds, over the ground; odom space.

        Args:
            number: Which of the frames.
            low_m: (3,) bounds, odom space.
            high_m: (3,) likewise.
        """
        if number not in self._tiles:
            self._tiles[number] = tiled(_off_ground(self._frames[number]))
        return cells_in_box(self._tiles[number], low_m, high_m)


def _off_ground(frame: LabelledFrame) -> Points:
    """(M, 3) what a frame sees off the ground, odom space."""
    points_m = frame.posed.frame.points_m
    index = returns_within(points_m, frame.posed.frame.valid_mask, _FARTHEST)
    if frame.predictive.ground_mask is not None:
        index = index[~frame.predictive.ground_mask[index]]
    return moved_rows(points_m, index, frame.posed.odom_from_sensor)
