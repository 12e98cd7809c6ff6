"""A grid of points that answers nearest-neighbour questions inside compiled loops."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.selfsupervised.compiled import compiled

CELL_XY_M = 0.5
CELL_Z_M = 1.0
REACH_XY_M = 82.0
REACH_DOWN_M = 8.0
REACH_UP_M = 5.0


class PointGrid(NamedTuple):
    """Points sorted by the cell they lie in.

    Points beyond the reach are kept in the cells of its rim, so answers are exact everywhere.

    Attributes:
        points_m: (N, 3) float32, sorted by cell.
        order: (N,) which of the given points each of them is.
        start: (cells + 1,) first point of each cell.
        origin_m: (3,) corner of the first cell.
        shape: (3,) cells along x, y, z.
    """

    points_m: Points
    order: NDArray[np.int32]
    start: NDArray[np.int32]
    origin_m: NDArray[np.float32]
    shape: NDArray[np.int64]


def build_grid(points_m: Points, centre_m: NDArray[np.floating]) -> PointGrid:
    """Sort points into cells around a centre, in time proportional to their number.

    Args:
        points_m: (N, 3) in any space, metres.
        centre_m: (3,) the middle of the grid in that space, usually the sensor.
    """
    reach = np.array([REACH_XY_M, REACH_XY_M, REACH_DOWN_M])
    span = np.array([2 * REACH_XY_M, 2 * REACH_XY_M, REACH_DOWN_M + REACH_UP_M])
    cell = np.array([CELL_XY_M, CELL_XY_M, CELL_Z_M])
    origin = (np.asarray(centre_m) - reach).astype(np.float32)
    shape = np.ceil(span / cell).astype(np.int64)
    sorted_points, order, start = _sort_into_cells(points_m, origin, shape)
    return PointGrid(sorted_points, order, start, origin, shape)


@compiled
def cell_along(value: float, origin: float, cell: float, count: int) -> int:
    """Index of the cell along one axis, clamped into the grid."""
    index = int(np.floor((value - origin) / cell))
    return min(max(index, 0), count - 1)


@compiled
def _sort_into_cells(
    points: Points, origin: NDArray[np.float32], shape: NDArray[np.int64]
) -> tuple[Points, NDArray[np.int32], NDArray[np.int32]]:
    n = len(points)
    cell_of = np.empty(n, np.int32)
    start = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int32)
    for i in range(n):
        x = cell_along(points[i, 0], origin[0], CELL_XY_M, shape[0])
        y = cell_along(points[i, 1], origin[1], CELL_XY_M, shape[1])
        z = cell_along(points[i, 2], origin[2], CELL_Z_M, shape[2])
        cell_of[i] = (x * shape[1] + y) * shape[2] + z
        start[cell_of[i] + 1] += 1
    for c in range(1, len(start)):
        start[c] += start[c - 1]
    fill = start[:-1].copy()
    sorted_points = np.empty((n, 3), np.float32)
    order = np.empty(n, np.int32)
    for i in range(n):
        at = fill[cell_of[i]]
        sorted_points[at] = points[i]
        order[at] = i
        fill[cell_of[i]] += 1
    return sorted_points, order, start


@compiled
def nearest(grid: PointGrid, x: float, y: float, z: float, reach: float) -> tuple[float, int]:
    """Find the nearest point of the grid.

    Returns:
        Squared distance and row in `grid.points_m`; `reach` squared and -1 when none is nearer.
    """
    points, start, origin, shape = grid.points_m, grid.start, grid.origin_m, grid.shape
    best, found = reach * reach, -1
    z0 = cell_along(z - reach, origin[2], CELL_Z_M, shape[2])
    z1 = cell_along(z + reach, origin[2], CELL_Z_M, shape[2])
    own_x = cell_along(x, origin[0], CELL_XY_M, shape[0])
    own_y = cell_along(y, origin[1], CELL_XY_M, shape[1])
    rings = int(np.ceil(reach / CELL_XY_M))
    # from the own column outwards: the first hits rule most of the others out
    for ring in range(rings + 1):
        for cx in range(max(own_x - ring, 0), min(own_x + ring, shape[0] - 1) + 1):
            edge = abs(cx - own_x) == ring
            for cy in range(own_y - ring, own_y + ring + 1, 1 if edge or ring == 0 else 2 * ring):
                if cy < 0 or cy >= shape[1]:
                    continue
                # how far the column is away at least; none for the outermost, which hold the rest
                ax = 0.0
                if cx < own_x and cx > 0:
                    ax = x - (origin[0] + (cx + 1) * CELL_XY_M)
                elif cx > own_x and cx < shape[0] - 1:
                    ax = origin[0] + cx * CELL_XY_M - x
                ay = 0.0
                if cy < own_y and cy > 0:
                    ay = y - (origin[1] + (cy + 1) * CELL_XY_M)
                elif cy > own_y and cy < shape[1] - 1:
                    ay = origin[1] + cy * CELL_XY_M - y
                if ax * ax + ay * ay >= best:
                    continue
                column = (cx * shape[1] + cy) * shape[2]
                # cells of a column follow each other, so one run over z is enough
                for j in range(start[column + z0], start[column + z1 + 1]):
                    dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
                    squared = dx * dx + dy * dy + dz * dz
                    if squared < best:
                        best, found = squared, j
    return best, found


@compiled
def nearest_distances(grid: PointGrid, points: Points, reach: float) -> NDArray[np.float32]:
    """Distance of each point to its nearest neighbour in the grid, at most `reach`; (N,)."""
    distance = np.empty(len(points), np.float32)
    for i in range(len(points)):
        squared, _ = nearest(grid, points[i, 0], points[i, 1], points[i, 2], reach)
        distance[i] = np.sqrt(squared)
    return distance


@compiled
def nearest_indices(grid: PointGrid, points: Points, reach: float) -> NDArray[np.int32]:
    """Row in `grid.points_m` of each point's nearest neighbour, -1 when none is nearer; (N,)."""
    index = np.empty(len(points), np.int32)
    for i in range(len(points)):
        _, index[i] = nearest(grid, points[i, 0], points[i, 1], points[i, 2], reach)
    return index
