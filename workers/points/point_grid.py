"""Point grid: points sorted by cell, a spatial index that is small and quick to build."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.points.compiled import compiled

CELL_M = 0.5
LAYERS = 32
"""Cells above each other: 16 m over the lowest point; higher points are in the highest cell."""

REACH_M = 82.0


class PointGrid(NamedTuple):
    """Points sorted by their cell of 0.5 m.

    Only columns with a point have cells. Points beyond the reach are in the outermost columns, so
    searches are exact everywhere.

    Attributes:
        points_m: (N, 3) float32, sorted by cell.
        order: (N,) index of each in the input.
        column: (X, Y) number of each column, -1 where there is no point.
        start: (columns * LAYERS + 1,) first point of each cell.
        origin_m: (3,) corner of the first cell.
    """

    points_m: Points
    order: NDArray[np.int32]
    column: NDArray[np.int32]
    start: NDArray[np.int32]
    origin_m: NDArray[np.float64]


def build_grid(points_m: Points, centre_m: NDArray[np.floating]) -> PointGrid:
    """Sort points into cells around a centre, in time proportional to their number.

    Args:
        points_m: (N, 3) in any space, metres.
        centre_m: (3,) the middle of the grid in that space, usually the sensor.
    """
    low, high = _bounds(points_m)
    centre = np.asarray(centre_m, np.float64)[:2]
    low[:2] = np.maximum(low[:2], centre - REACH_M)
    size = np.minimum(high[:2], centre + REACH_M) - low[:2]
    x, y = (int(max(along, 0.0) / CELL_M) + 1 for along in size)
    return PointGrid(*_sorted(points_m, low, x, y), low)


@compiled
def cell_along(value: float, origin: float, count: int) -> int:
    """Return the index of the cell along one axis, clamped into the grid."""
    index = int(np.floor((value - origin) * (1.0 / CELL_M)))
    return min(max(index, 0), count - 1)


@compiled
def _bounds(points: Points) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and highest value of each coordinate; zero without points."""
    low, high = np.zeros(3, np.float32), np.zeros(3, np.float32)
    if len(points) > 0:
        low[:], high[:] = points[0], points[0]
    for i in range(len(points)):
        for axis in range(3):
            low[axis] = min(low[axis], points[i, axis])
            high[axis] = max(high[axis], points[i, axis])
    return low.astype(np.float64), high.astype(np.float64)


@compiled
def _sorted(
    points: Points, origin: NDArray[np.float64], count_x: int, count_y: int
) -> tuple[Points, NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    n, columns = len(points), 0
    column = np.full((count_x, count_y), -1, np.int32)
    cell_of = np.empty(n, np.int32)
    for i in range(n):
        x = cell_along(points[i, 0], origin[0], count_x)
        y = cell_along(points[i, 1], origin[1], count_y)
        if column[x, y] < 0:
            column[x, y] = columns
            columns += 1
        cell_of[i] = column[x, y] * LAYERS + cell_along(points[i, 2], origin[2], LAYERS)
    start = np.zeros(columns * LAYERS + 1, np.int32)
    for i in range(n):
        start[cell_of[i] + 1] += 1
    for c in range(1, len(start)):
        start[c] += start[c - 1]
    fill = start[:-1].copy()
    sorted_points = np.empty((n, 3), np.float32)
    order = np.empty(n, np.int32)
    for i in range(n):
        at = fill[cell_of[i]]
        fill[cell_of[i]] += 1
        order[at] = i
        for axis in range(3):
            sorted_points[at, axis] = points[i, axis]
    return sorted_points, order, column, start
