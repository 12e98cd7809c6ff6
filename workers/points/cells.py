"""Cell grid for connected components: points sorted by cell, cells by column, columns by hash."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.points.compiled import compiled


class Cells(NamedTuple):
    """Points sorted by cell, and cells by column and height; two groups never share a cell.

    Attributes:
        points_m: (M, 3) sorted.
        order: (M,) row of each in the input; ascending in a cell.
        start: (cells + 1,) first point of each cell.
        height: (cells,) vertical index of each cell.
        group: (cells,) group of its points.
        first: (columns + 1,) first cell of each column.
        place: (columns, 2) horizontal index of each column.
        slots: Hash table from places to columns.
    """

    points_m: Points
    order: NDArray[np.int32]
    start: NDArray[np.int32]
    height: NDArray[np.int32]
    group: NDArray[np.int32]
    first: NDArray[np.int32]
    place: NDArray[np.int32]
    slots: NDArray[np.int32]


@compiled
def _slot(x: int, y: int, mask: int) -> int:
    return (x * 73856093 ^ y * 19349663) & mask


@compiled
def column_at(place: NDArray[np.int32], slots: NDArray[np.int32], x: int, y: int) -> int:
    """Return the number of the column at a place, -1 where there is none."""
    mask = len(slots) - 1
    slot = _slot(x, y, mask)
    while slots[slot] >= 0:
        if place[slots[slot], 0] == x and place[slots[slot], 1] == y:
            return int(slots[slot])
        slot = (slot + 1) & mask
    return -1


@compiled
def sorted_cells(
    points: Points, index: NDArray[np.int32], group: NDArray[np.int32], edge: np.float32
) -> Cells:
    """Sort selected points into cells of an edge; (M,) selected, (M,) their groups."""
    m = len(index)
    column_of, height_of, place, slots = _columns(points, index, edge)
    first_point = np.zeros(len(place) + 1, np.int32)
    for i in range(m):
        first_point[column_of[i] + 1] += 1
    for c in range(len(place)):
        first_point[c + 1] += first_point[c]
    fill = first_point[:-1].copy()
    order = np.empty(m, np.int32)
    for i in _by_height(height_of):
        # already behind all lower points of its column: only other groups of one cell are passed
        at = fill[column_of[i]]
        fill[column_of[i]] += 1
        while at > first_point[column_of[i]]:
            j = order[at - 1]
            below = height_of[j] < height_of[i]
            if below or (height_of[j] == height_of[i] and group[j] <= group[i]):
                break
            order[at] = j
            at -= 1
        order[at] = i
    sorted_points = np.empty((m, 3), np.float32)
    start = np.empty(m + 1, np.int32)
    height, cell_group = np.empty(m, np.int32), np.empty(m, np.int32)
    first = np.zeros(len(place) + 1, np.int32)
    count = 0
    for c in range(len(place)):
        for at in range(first_point[c], first_point[c + 1]):
            i = order[at]
            for axis in range(3):
                sorted_points[at, axis] = points[index[i], axis]
            same = at > first_point[c] and height[count - 1] == height_of[i]
            if not (same and cell_group[count - 1] == group[i]):
                start[count], height[count], cell_group[count] = at, height_of[i], group[i]
                count += 1
        first[c + 1] = count
    start[count] = m
    return Cells(
        sorted_points,
        order,
        start[: count + 1],
        height[:count],
        cell_group[:count],
        first,
        place,
        slots,
    )


@compiled
def _by_height(height_of: NDArray[np.int32]) -> NDArray[np.int32]:
    """Order points by rising height, equals in the given order; all so where heights span far."""
    m = len(height_of)
    order = np.arange(m).astype(np.int32)
    if m == 0:
        return order
    low, high = np.int64(height_of[0]), np.int64(height_of[0])
    for i in range(m):
        low, high = min(low, np.int64(height_of[i])), max(high, np.int64(height_of[i]))
    if high - low > m:
        return order
    place = np.zeros(high - low + 2, np.int32)
    for i in range(m):
        place[height_of[i] - low + 1] += 1
    for h in range(high - low + 1):
        place[h + 1] += place[h]
    for i in range(m):
        order[place[height_of[i] - low]] = i
        place[height_of[i] - low] += 1
    return order


@compiled
def _columns(
    points: Points, index: NDArray[np.int32], edge: np.float32
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Return each point's column and height, each column's place, and the hash table of places."""
    m = len(index)
    size = 16
    while size < 2 * m:
        size *= 2
    slots = np.full(size, -1, np.int32)
    place = np.empty((m, 2), np.int32)
    column_of, height_of = np.empty(m, np.int32), np.empty(m, np.int32)
    used = 0
    for i in range(m):
        x = np.int32(np.floor(points[index[i], 0] / edge))
        y = np.int32(np.floor(points[index[i], 1] / edge))
        height_of[i] = np.int32(np.floor(points[index[i], 2] / edge))
        slot = _slot(int(x), int(y), size - 1)
        while slots[slot] >= 0 and (place[slots[slot], 0] != x or place[slots[slot], 1] != y):
            slot = (slot + 1) & (size - 1)
        if slots[slot] < 0:
            slots[slot] = used
            place[used, 0], place[used, 1] = x, y
            used += 1
        column_of[i] = slots[slot]
    return column_of, height_of, place[:used], slots
