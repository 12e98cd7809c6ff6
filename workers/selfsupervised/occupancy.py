"""Occupancy grid as bit columns, for the coarse search of a cluster's earlier place."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.points.compiled import compiled

CELL_M = 0.3
REACH_M = 82.0
REACH_DOWN_M = 10.0
_COLUMNS = int(2 * REACH_M / CELL_M) + 1


class Occupancy(NamedTuple):
    """Occupied cells of 0.3 m, 64 of them above each other in one integer.

    Attributes:
        bits: (C, C, 2) cells with a point, and cells with a point in them or in a neighbour.
        origin_m: (3,) corner of the first cell.
    """

    bits: NDArray[np.uint64]
    origin_m: NDArray[np.float32]


def build_occupancy(points_m: Points, centre_m: NDArray[np.floating]) -> Occupancy:
    """Mark the cells of points around a centre, and their 26 neighbours.

    Args:
        points_m: (N, 3) in any space, metres; those beyond 82 m are left out.
        centre_m: (3,) the middle in that space.
    """
    reach = np.array([REACH_M, REACH_M, REACH_DOWN_M])
    origin = (np.asarray(centre_m) - reach).astype(np.float32)
    # not in the compiled loop, which would fill it: what stays zero takes no memory
    bits = np.zeros((_COLUMNS, _COLUMNS, 2), np.uint64)
    _mark(points_m, origin, bits)
    return Occupancy(bits, origin)


@compiled
def _mark(points: Points, origin: NDArray[np.float32], bits: NDArray[np.uint64]) -> None:
    one = np.uint64(1)
    for i in range(len(points)):
        x = int(np.floor((points[i, 0] - origin[0]) / CELL_M))
        y = int(np.floor((points[i, 1] - origin[1]) / CELL_M))
        z = int(np.floor((points[i, 2] - origin[2]) / CELL_M))
        if not (1 <= x < _COLUMNS - 1 and 1 <= y < _COLUMNS - 1 and 1 <= z < 63):
            continue
        bits[x, y, 0] |= one << np.uint64(z)
        three = np.uint64(7) << np.uint64(z - 1)
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                bits[x + dx, y + dy, 1] |= three


@compiled
def scores_around(
    occupancy: Occupancy, cells: NDArray[np.int64], cx: int, cy: int, reach: int
) -> NDArray[np.float64]:
    """Score shifts of cells by the share on occupied cells; a neighbouring cell counts a third.

    Args:
        occupancy: Grid of the frame that the cells are shifted to.
        cells: (n, 3) from `cells_of`.
        cx: Shift in the middle of the search window, cells along x.
        cy: The same along y.
        reach: Half the side of the window, cells.

    Returns:
        (2 * reach + 1, 2 * reach + 1), 1 where all cells fall on points.
    """
    side = 2 * reach + 1
    # both kinds of cells next to each other, as in memory, for vector instructions
    hits = np.zeros((side, 2 * side), np.uint64)
    bits = occupancy.bits.reshape((_COLUMNS, 2 * _COLUMNS))
    one = np.uint64(1)
    for n in range(len(cells)):
        z = np.uint64(cells[n, 2])
        x0, y0 = cells[n, 0] + cx - reach, cells[n, 1] + cy - reach
        first, last = max(0, -y0), min(side, _COLUMNS - y0)
        if first >= last:
            continue
        for i in range(max(0, -x0), min(side, _COLUMNS - x0)):
            there, hit = bits[x0 + i, 2 * (y0 + first) :], hits[i, 2 * first : 2 * last]
            for k in range(len(hit)):
                hit[k] += (there[k] >> z) & one
    score = np.empty((side, side), np.float64)
    for i in range(side):
        for j in range(side):
            score[i, j] = np.int64(2 * hits[i, 2 * j] + hits[i, 2 * j + 1]) / (3.0 * len(cells))
    return score


@compiled
def cells_of(occupancy: Occupancy, points: Points) -> NDArray[np.int64]:
    """Return the cell of each point, (n, 3); heights outside the grid get its unused first bit."""
    cells = np.empty((len(points), 3), np.int64)
    for i in range(len(points)):
        for axis in range(3):
            cells[i, axis] = int(np.floor((points[i, axis] - occupancy.origin_m[axis]) / CELL_M))
        if cells[i, 2] < 0 or cells[i, 2] > 63:
            cells[i, 2] = 0
    return cells
