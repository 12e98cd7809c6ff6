"""Connected components of points: cells whose points are all joined, then union-find over cells."""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.points.cells import Cells, column_at, sorted_cells
from workers.points.compiled import compiled, inlined

_EDGE_SHARE = 0.577
"""Edge of a cell over the reach: its diagonal, sqrt(3) edges, is shorter than the reach."""

_SPAN = 2
"""Cells farther apart than this along an axis contain no points within reach."""


@compiled
def components(
    points: Points, index: NDArray[np.int32], group: NDArray[np.int32], reach: np.float32
) -> NDArray[np.int32]:
    """Join points that are nearer than a reach, directly or through others.

    The result is exact, as that of a search around every point: all points of a cell are joined
    without a test, and two cells are compared point by point only while they are not joined yet.

    Args:
        points: (N, 3) metres.
        index: (M,) indices of the points that take part.
        group: (M,) only points of one group are joined.
        reach: Metres.

    Returns:
        (M,) the first row of `index` in the component of each.
    """
    cells = sorted_cells(points, index, group, reach * np.float32(_EDGE_SHARE))
    count = len(cells.height)
    parent = np.arange(count).astype(np.int32)
    place, slots = cells.place, cells.slots
    for away in range(_SPAN + 1):  # touching columns first: they rule most of the others out
        whole = _whole_columns(cells, parent)
        for c in range(len(place)):
            x, y = place[c, 0], place[c, 1]
            for step_x in range(away + 1):
                for step_y in range(-away if step_x else 0, away + 1):
                    if max(step_x, abs(step_y)) != away:
                        continue
                    other = column_at(place, slots, x + step_x, y + step_y)
                    if other >= 0 and not _joined(parent, whole[c], whole[other]):
                        _join_columns(cells, parent, c, other, reach)
    earliest = np.full(count, len(index), np.int32)
    for k in range(count):
        root = _find(parent, k)
        earliest[root] = min(earliest[root], cells.order[cells.start[k]])
    found = np.empty(len(index), np.int32)
    for k in range(count):
        root = _find(parent, k)
        for at in range(cells.start[k], cells.start[k + 1]):
            found[cells.order[at]] = earliest[root]
    return found


@compiled
def _whole_columns(cells: Cells, parent: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return (columns,) a cell of each column whose cells are all joined, -1 for the others."""
    first, whole = cells.first, np.empty(len(cells.place), np.int32)
    for c in range(len(whole)):
        whole[c] = _find(parent, first[c])
        for k in range(first[c] + 1, first[c + 1]):
            if _find(parent, k) != whole[c]:
                whole[c] = -1
                break
    return whole


@compiled
def _joined(parent: NDArray[np.int32], one: int, other: int) -> bool:
    """Return True if two cells are joined already; -1 is no cell."""
    return one >= 0 and other >= 0 and _find(parent, one) == _find(parent, other)


@inlined
def _join_columns(
    cells: Cells, parent: NDArray[np.int32], one: int, other: int, reach: np.float32
) -> None:
    """Join cells of two columns that are within reach of each other."""
    low = cells.first[other]
    for a in range(cells.first[one], cells.first[one + 1]):
        while low < cells.first[other + 1] and cells.height[low] < cells.height[a] - _SPAN:
            low += 1
        root = _find(parent, a)
        # within one column every pair is met from its lower cell
        for b in range(max(low, a + 1) if one == other else low, cells.first[other + 1]):
            if cells.height[b] > cells.height[a] + _SPAN:
                break
            if cells.group[b] != cells.group[a]:
                continue
            there = _find(parent, b)
            if there != root and _touch(cells, a, b, reach):
                parent[max(root, there)] = min(root, there)
                root = min(root, there)


@compiled
def _touch(cells: Cells, a: int, b: int, reach: np.float32) -> bool:
    points = cells.points_m
    for i in range(cells.start[a], cells.start[a + 1]):
        for j in range(cells.start[b], cells.start[b + 1]):
            dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
            dz = points[j, 2] - points[i, 2]
            if dx * dx + dy * dy + dz * dz < reach * reach:
                return True
    return False


@compiled
def _find(parent: NDArray[np.int32], i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i
