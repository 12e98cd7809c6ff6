"""Road rows: points as low as the road that no longer count as ground.

Ground removal misses rows of road next to a mover, or the self-supervised stream gives them to it,
since they touch its wheels or feet. They contradict a supervised stream that labels the road
static, and form an object of their own: a patch of road next to a cyclist.
"""

from typing import Final

import numpy as np

from schemas.arrays import Mask, Points
from workers.points.compiled import compiled, inlined

CELL_M: Final = 1.0
"""Side of a cell, metres; a point is compared with its own cell and the eight around it."""

LOW_M: Final = 0.1
"""Height over the lowest ground around up to which a point is of the road, metres. Sills and
bumpers are above it. A road that falls by 5 % stays below it."""

_WITHIN_M: Final = 100.0
_CELLS: Final = round(2 * _WITHIN_M / CELL_M)
_NO_GROUND_M: Final = 1e6
"""Height above every ground, metres: cells without ground are higher."""


def road_rows(points_m: Points, candidates: Mask, ground: Mask) -> Mask:
    """Find the candidates that are as low as the ground around them.

    Args:
        points_m: (N, 3) points, sensor space, metres.
        candidates: (N,) points off the ground.
        ground: (N,) ground points.

    Returns:
        (N,) mask; none beyond 100 m each way, and none where no ground is near.
    """
    return _road_rows(points_m, candidates, ground)


@compiled
def _road_rows(points: Points, candidates: Mask, ground: Mask) -> Mask:
    low = np.zeros(len(points), np.bool_)
    lowest = np.full((_CELLS + 2, _CELLS + 2), np.float32(np.inf))
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        if ground[i] and abs(x) < _WITHIN_M and abs(y) < _WITHIN_M:
            a, b = _cell(x), _cell(y)
            lowest[a, b] = min(lowest[a, b], points[i, 2])
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        if candidates[i] and abs(x) < _WITHIN_M and abs(y) < _WITHIN_M:
            a, b = _cell(x), _cell(y)
            around = np.float32(np.inf)
            for step_a in range(-1, 2):
                for step_b in range(-1, 2):
                    around = min(around, lowest[a + step_a, b + step_b])
            low[i] = around < _NO_GROUND_M and points[i, 2] - around < LOW_M
    return low


@inlined
def _cell(along: np.float32) -> int:
    """Return the row or column of a coordinate; the outermost cells stay empty."""
    return int(np.floor((along + _WITHIN_M) / CELL_M)) + 1
