"""Road rows: points as low as the road that no longer count as ground.

Ground removal misses rows of road next to a mover, or the self-supervised stream gives them to it,
since they touch its wheels or feet. They contradict a supervised stream that labels the road
static, and form an object of their own: a patch of road next to a cyclist.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points

CELL_M: Final = 1.0
"""Side of a cell, metres; a point is compared with its own cell and the eight around it."""

LOW_M: Final = 0.1
"""Height over the lowest ground around up to which a point is of the road, metres. Sills and
bumpers are above it. A road that falls by 5 % stays below it."""

_WITHIN_M: Final = 100.0
_CELLS: Final = round(2 * _WITHIN_M / CELL_M)


def road_rows(points_m: Points, candidates: Mask, ground: Mask) -> Mask:
    """Find the candidates that are as low as the ground around them.

    Args:
        points_m: (N, 3) points, sensor space, metres.
        candidates: (N,) points off the ground.
        ground: (N,) ground points.

    Returns:
        (N,) mask; none beyond 100 m each way, and none where no ground is near.
    """
    low = np.zeros(len(points_m), np.bool_)
    index, of_ground = (_within(points_m, mask) for mask in (candidates, ground))
    if not len(index) or not len(of_ground):
        return low
    lowest_m = np.full((_CELLS + 2, _CELLS + 2), np.inf, np.float32)
    np.minimum.at(lowest_m, _cells(points_m[of_ground]), points_m[of_ground, 2])
    x, y = _cells(points_m[index])
    around_m = np.full(len(index), np.inf, np.float32)
    for step_x in (-1, 0, 1):
        for step_y in (-1, 0, 1):
            around_m = np.minimum(around_m, lowest_m[x + step_x, y + step_y])
    low[index] = np.isfinite(around_m) & (points_m[index, 2] - around_m < LOW_M)
    return low


def _within(points_m: Points, mask: Mask) -> NDArray[np.int64]:
    index = np.flatnonzero(mask)
    near = (np.abs(points_m[index, :2]) < _WITHIN_M).all(axis=1)
    return index[near]


def _cells(points_m: Points) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return row and column of each point's cell; the outermost ones stay empty."""
    at = np.floor((points_m[:, :2] + _WITHIN_M) / CELL_M).astype(np.int64).clip(0, _CELLS - 1) + 1
    return at[:, 0], at[:, 1]
