"""DBSCAN over weighted places, compiled, with the labels of scikit-learn."""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.points.compiled import compiled

Counts = NDArray[np.int64]
Places = NDArray[np.float64]


@compiled
def weighted_places(points: Points, voxel: np.float32) -> tuple[Places, Counts, Counts]:
    """Replace the points of each voxel by their mean.

    Args:
        points: (N, 3) metres, within 100 km.
        voxel: Edge of a voxel, metres.

    Returns:
        (V, 3) means, by the voxels' x, then y, then z; (N,) place of each point; (V,) points of
        each place.
    """
    n = len(points)
    slots = 16
    while slots < 2 * n:
        slots *= 2
    voxel_of_slot = np.full(slots, -1, np.int64)
    key, found, weight = np.empty(n, np.int64), np.empty(n, np.int64), np.zeros(n, np.int64)
    total = np.zeros((n, 3), np.float64)
    used = 0
    for i in range(n):
        own = np.int64(0)
        for axis in range(3):
            own = (own << 21) + np.int64(np.floor(points[i, axis] / voxel)) + (1 << 20)
        slot = ((own * 0x9E3779B97F4A7C1) >> 20) & (slots - 1)
        while voxel_of_slot[slot] >= 0 and key[voxel_of_slot[slot]] != own:
            slot = (slot + 1) & (slots - 1)
        if voxel_of_slot[slot] < 0:
            voxel_of_slot[slot] = used
            key[used] = own
            used += 1
        v = voxel_of_slot[slot]
        found[i] = v
        weight[v] += 1
        for axis in range(3):
            total[v, axis] += points[i, axis]
    order = np.argsort(key[:used])
    rank = np.empty(used, np.int64)
    means, weights = np.empty((used, 3), np.float64), np.empty(used, np.int64)
    for place in range(used):
        v = order[place]
        rank[v] = place
        weights[place] = weight[v]
        for axis in range(3):
            means[place, axis] = total[v, axis] / weight[v]
    for i in range(n):
        found[i] = rank[found[i]]
    return means, found, weights


@compiled
def density_clusters(places: Places, weight: Counts, reach: float, least: int) -> Counts:
    """Cluster places with the same labels as scikit-learn's DBSCAN.

    A place is core if the weight within reach, its own included, is enough; cores within reach
    of each other are in one cluster. Other places within reach of a core join the first such
    cluster; clusters are numbered by their first core.

    Args:
        places: (V, 3) metres.
        weight: (V,) of each.
        reach: Metres, inclusive.
        least: Weight that makes a core.

    Returns:
        (V,) cluster of each place, -1 for noise.
    """
    count = len(places)
    labels = np.full(count, -1, np.int64)
    if count == 0:
        return labels
    members, first, cell_of, block = _blocks(places, reach * 1.0001)
    squared_reach = reach * reach
    is_core = np.zeros(count, np.bool_)
    for i in range(count):
        weighs = 0
        for side in range(9):
            begin, end = block[cell_of[i], side, 0], block[cell_of[i], side, 1]
            for at in range(first[begin], first[end]):
                if _squared(places, i, members[at]) <= squared_reach:
                    weighs += weight[members[at]]
                    if weighs >= least:
                        break
            if weighs >= least:
                is_core[i] = True
                break
    unlabelled = first[1:].copy()  # end of each cell's unlabelled places; labelled ones follow
    stack = np.empty(count, np.int64)
    clusters = 0
    for seed in range(count):
        if labels[seed] >= 0 or not is_core[seed]:
            continue
        labels[seed], stack[0], height = clusters, seed, 1
        while height > 0:
            height -= 1
            i = stack[height]
            for side in range(9):
                for cell in range(block[cell_of[i], side, 0], block[cell_of[i], side, 1]):
                    at = first[cell]
                    while at < unlabelled[cell]:
                        j = members[at]
                        if labels[j] < 0 and _squared(places, i, j) <= squared_reach:
                            labels[j] = clusters
                            if is_core[j]:
                                stack[height] = j
                                height += 1
                        if labels[j] < 0:
                            at += 1
                            continue
                        unlabelled[cell] -= 1
                        members[at] = members[unlabelled[cell]]
        clusters += 1
    return labels


@compiled
def _squared(places: Places, i: int, j: int) -> float:
    dx, dy = places[i, 0] - places[j, 0], places[i, 1] - places[j, 1]
    dz = places[i, 2] - places[j, 2]
    return float(dx * dx + dy * dy + dz * dz)


@compiled
def _blocks(places: Places, edge: float) -> tuple[Counts, Counts, Counts, Counts]:
    """Sort places into cells, and find the cells around each: nine runs, as z comes last.

    Returns:
        (V,) places by cell; (cells + 1,) first of each cell; (V,) cell of each place;
        (cells, 9, 2) the runs of cells that touch each, begin and end.
    """
    count = len(places)
    low = places[0].copy()
    for i in range(count):
        for axis in range(3):
            low[axis] = min(low[axis], places[i, axis])
    key = np.zeros(count, np.int64)
    for i in range(count):
        for axis in range(3):  # from 1 on, so that one below the lowest is in no other column
            key[i] = (key[i] << 21) + np.int64(np.floor((places[i, axis] - low[axis]) / edge)) + 1
    members = np.argsort(key)
    cell_of, cells = np.empty(count, np.int64), 0
    cell_key, first = np.empty(count, np.int64), np.empty(count + 1, np.int64)
    for at in range(count):
        own = key[members[at]]
        if at == 0 or cell_key[cells - 1] != own:
            cell_key[cells], first[cells] = own, at
            cells += 1
        cell_of[members[at]] = cells - 1
    first[cells] = count
    block = np.empty((cells, 9, 2), np.int64)
    for side in range(9):
        step = ((side // 3 - 1) << 42) + ((side % 3 - 1) << 21)
        begin = end = 0  # both only increase, as the keys do
        for c in range(cells):
            wanted = cell_key[c] + step
            while begin < cells and cell_key[begin] < wanted - 1:
                begin += 1
            end = max(end, begin)
            while end < cells and cell_key[end] <= wanted + 1:
                end += 1
            block[c, side, 0], block[c, side, 1] = begin, end
    return members, first[: cells + 1], cell_of, block
