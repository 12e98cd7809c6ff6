"""Nearest-neighbour search in a grid of points, inside compiled loops."""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from workers.points.compiled import compiled, inlined
from workers.points.point_grid import CELL_M, LAYERS, PointGrid, build_grid, cell_along

__all__ = [
    "PointGrid",
    "build_grid",
    "is_alone",
    "nearer",
    "nearest_distances",
    "nearest_few",
    "nearest_indices",
    "nearest_rows",
]

_FIRST_REACH_M = 0.5
"""First search radius for several neighbours, metres; it doubles where there are too few."""


@inlined
def nearer(
    grid: PointGrid, x: float, y: float, z: float, best: float, found: int
) -> tuple[float, int]:
    """Find the nearest point of the grid, if it is nearer than a known one.

    Args:
        grid: The points.
        x: First coordinate of the query.
        y: The second coordinate.
        z: The third.
        best: Squared distance of the known point, or of the reach.
        found: Its row in `grid.points_m`, or -1.

    Returns:
        Squared distance and row of the nearest; unchanged when none is nearer.
    """
    points, column, start, origin = grid.points_m, grid.column, grid.start, grid.origin_m
    count_x, count_y = column.shape
    own_x = cell_along(x, origin[0], count_x)
    own_y = cell_along(y, origin[1], count_y)
    own_z = cell_along(z, origin[2], LAYERS)
    # the own cell first: its points rule most of the other cells out
    first = column[own_x, own_y] * LAYERS
    if first >= 0:
        for j in range(start[first + own_z], start[first + own_z + 1]):
            dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
            squared = dx * dx + dy * dy + dz * dz
            if squared < best:
                best, found = squared, j
    # distances to the six sides of the own cell; negative outside of the grid
    left, front = x - (origin[0] + own_x * CELL_M), y - (origin[1] + own_y * CELL_M)
    right, back = CELL_M - left, CELL_M - front
    down = z - (origin[2] + own_z * CELL_M)
    up = CELL_M - down
    reach = np.sqrt(best)
    if reach <= min(min(min(left, right), min(front, back)), min(down, up)):
        return best, found
    low, high = max(own_z - _cells(reach - down), 0), min(own_z + _cells(reach - up), LAYERS - 1)
    for cx in range(
        max(own_x - _cells(reach - left), 0),
        min(own_x + _cells(reach - right), count_x - 1) + 1,
    ):
        ax = _between(cx - own_x, left, right)
        if ax * ax >= best:
            continue
        for cy in range(
            max(own_y - _cells(reach - front), 0),
            min(own_y + _cells(reach - back), count_y - 1) + 1,
        ):
            ay = _between(cy - own_y, front, back)
            first = column[cx, cy] * LAYERS
            if first < 0 or ax * ax + ay * ay >= best:
                continue
            # cells of a column follow each other, so one run over z is enough
            for j in range(start[first + low], start[first + high + 1]):
                dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
                squared = dx * dx + dy * dy + dz * dz
                if squared < best:
                    best, found = squared, j
    return best, found


@compiled
def _cells(length: float) -> int:
    """Count the cells that a length beyond the own cell spans."""
    return max(int(np.ceil(length * (1.0 / CELL_M))), 0)


@compiled
def _between(step: int, before: float, after: float) -> float:
    """Return the distance from a place to the cell that many steps away, along one axis."""
    if step < 0:
        return before + (-step - 1) * CELL_M
    if step > 0:
        return after + (step - 1) * CELL_M
    return 0.0


@compiled
def nearest_distances(grid: PointGrid, points: Points, reach: float) -> NDArray[np.float32]:
    """Measure the distance of each point to its neighbour in the grid, at most `reach`; (N,)."""
    distance = np.empty(len(points), np.float32)
    for i in range(len(points)):
        squared, _ = nearer(grid, points[i, 0], points[i, 1], points[i, 2], reach * reach, -1)
        distance[i] = np.sqrt(squared)
    return distance


@compiled
def is_alone(grid: PointGrid, points: Points, reach: np.float32) -> Mask:
    """Mark the points without a neighbour in the grid within reach, inclusive; (N,).

    It is `nearest_distances(...) > reach`, but a search ends at the first neighbour within reach.
    """
    alone = np.empty(len(points), np.bool_)
    for i in range(len(points)):
        alone[i] = _is_alone(grid, points[i, 0], points[i, 1], points[i, 2], reach)
    return alone


@inlined
def _is_alone(grid: PointGrid, x: float, y: float, z: float, reach: np.float32) -> bool:
    points, column, start, origin = grid.points_m, grid.column, grid.start, grid.origin_m
    count_x, count_y = column.shape
    wide = 1.01 * float(reach)  # cells are passed over by more than the rounding of distances
    own_x, own_y = cell_along(x, origin[0], count_x), cell_along(y, origin[1], count_y)
    low, high = cell_along(z - wide, origin[2], LAYERS), cell_along(z + wide, origin[2], LAYERS)
    first = column[own_x, own_y] * LAYERS
    if first >= 0:
        for j in range(start[first + low], start[first + high + 1]):
            dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
            if np.float32(np.sqrt(dx * dx + dy * dy + dz * dz)) <= reach:
                return False
    for cx in range(
        cell_along(x - wide, origin[0], count_x), cell_along(x + wide, origin[0], count_x) + 1
    ):
        for cy in range(
            cell_along(y - wide, origin[1], count_y), cell_along(y + wide, origin[1], count_y) + 1
        ):
            first = column[cx, cy] * LAYERS
            if first < 0 or (cx == own_x and cy == own_y):
                continue
            for j in range(start[first + low], start[first + high + 1]):
                dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
                if np.float32(np.sqrt(dx * dx + dy * dy + dz * dz)) <= reach:
                    return False
    return True


@compiled
def nearest_rows(grid: PointGrid, points: NDArray[np.floating], reach: float) -> NDArray[np.int32]:
    """Find the row of each point's nearest neighbour, -1 beyond the reach; (N,)."""
    rows = np.empty(len(points), np.int32)
    for i in range(len(points)):
        _, rows[i] = nearer(grid, points[i, 0], points[i, 1], points[i, 2], reach * reach, -1)
    return rows


@compiled
def nearest_few(grid: PointGrid, points: Points, count: int) -> NDArray[np.int32]:
    """Find the rows of each point's nearest neighbours, nearest first; (N, few).

    The grid must contain as many points.
    """
    rows = np.full((len(points), count), -1, np.int32)
    squared = np.empty(count, np.float64)
    for i in range(len(points)):
        reach = _FIRST_REACH_M
        squared[:] = np.inf
        while not _few_within(grid, points[i], reach, squared, rows[i]):
            reach *= 2.0
            squared[:] = np.inf
    return rows


@compiled
def _few_within(
    grid: PointGrid,
    place: NDArray[np.float32],
    reach: float,
    squared: NDArray[np.float64],
    rows: NDArray[np.int32],
) -> bool:
    """Insert the nearest points of all cells within reach; True if none beyond is nearer."""
    points, column, start, origin = grid.points_m, grid.column, grid.start, grid.origin_m
    count_x, count_y = column.shape
    x, y, z = np.float64(place[0]), np.float64(place[1]), np.float64(place[2])
    first_x = cell_along(x - reach, origin[0], count_x)
    last_x = cell_along(x + reach, origin[0], count_x)
    first_y = cell_along(y - reach, origin[1], count_y)
    last_y = cell_along(y + reach, origin[1], count_y)
    low, high = cell_along(z - reach, origin[2], LAYERS), cell_along(z + reach, origin[2], LAYERS)
    last = len(squared) - 1
    for cx in range(first_x, last_x + 1):
        for cy in range(first_y, last_y + 1):
            first = column[cx, cy] * LAYERS
            if first < 0:
                continue
            for j in range(start[first + low], start[first + high + 1]):
                dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
                away = dx * dx + dy * dy + dz * dz
                if away >= squared[last]:
                    continue
                at = last
                while at > 0 and squared[at - 1] > away:
                    squared[at], rows[at] = squared[at - 1], rows[at - 1]
                    at -= 1
                squared[at], rows[at] = away, j
    wide = first_x == 0 and last_x == count_x - 1 and first_y == 0 and last_y == count_y - 1
    return squared[last] <= reach * reach or (wide and low == 0 and high == LAYERS - 1)


@compiled
def nearest_indices(grid: PointGrid, points: Points, reach: float) -> NDArray[np.int32]:
    """Find the row of each point's nearest neighbour, -1 beyond the reach; (N,).

    It is faster than `nearest_rows` for grids of few points: it skips a query without an occupied
    column within reach.
    """
    index = np.empty(len(points), np.int32)
    around = _around(grid.column, _cells(reach))
    count_x, count_y = around.shape
    for i in range(len(points)):
        cx = cell_along(points[i, 0], grid.origin_m[0], count_x)
        cy = cell_along(points[i, 1], grid.origin_m[1], count_y)
        index[i] = -1
        if around[cx, cy]:
            _, index[i] = nearer(grid, points[i, 0], points[i, 1], points[i, 2], reach * reach, -1)
    return index


@compiled
def _around(column: NDArray[np.int32], reach: int) -> Mask:
    """Dilate (X, Y) occupied columns by a reach."""
    count_x, count_y = column.shape
    around = np.zeros(column.shape, np.bool_)
    for x in range(count_x):
        for y in range(count_y):
            if column[x, y] >= 0:
                around[
                    max(x - reach, 0) : min(x + reach + 1, count_x),
                    max(y - reach, 0) : min(y + reach + 1, count_y),
                ] = True
    return around
