"""Shape matching: distances of a shape to another frame's points under shifts, compiled.

The points of a frame are sorted into tiles once. For each shape that is compared, those around it
are sorted into small cells, row by row. A search visits the rows from its own one outwards, and in
each only the cells nearer than the best point so far. No tree is built, and every distance is
exactly that to the nearest point.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.points.compiled import compiled

_TILE_M = 2.0
_CELL_M = 0.5

_MOST_TILES = 1024.0
_MOST_CELLS = 256.0
"""Greatest numbers each way: tiles and cells of a larger extent have longer edges."""

Places = NDArray[np.float64]


class Tiles(NamedTuple):
    """Places sorted by square tiles over the ground.

    Attributes:
        places_m: (M, 3) places by tile: row by row along x, in each row along y.
        first: (tiles + 1,) index of the first place of each tile.
        low_m: (2,) corner of the first tile, metres.
        edge_m: Edge of a tile, metres.
        deep: Number of tiles along y.
    """

    places_m: Points
    first: NDArray[np.int32]
    low_m: Places
    edge_m: float
    deep: int


class Cells(NamedTuple):
    """Places (M, 2) over the ground sorted by small cells, with the attributes of `Tiles`."""

    places_m: Places
    first: NDArray[np.int32]
    low_m: Places
    edge_m: float
    deep: int


@compiled
def tiled(places: Points) -> Tiles:
    """Sort places (M, 3), metres, into tiles."""
    low, high = np.zeros(2), np.zeros(2)
    for axis in range(2):
        for i in range(len(places)):
            at = np.float64(places[i, axis])
            low[axis] = at if i == 0 else min(low[axis], at)
            high[axis] = at if i == 0 else max(high[axis], at)
    edge = max(_TILE_M, max(high[0] - low[0], high[1] - low[1]) / _MOST_TILES)
    wide, deep = int((high[0] - low[0]) / edge) + 1, int((high[1] - low[1]) / edge) + 1
    tile = np.empty(len(places), np.int32)
    first = np.zeros(wide * deep + 1, np.int32)
    for i in range(len(places)):
        along, aside = np.float64(places[i, 0]) - low[0], np.float64(places[i, 1]) - low[1]
        tile[i] = int(along / edge) * deep + int(aside / edge)
        first[tile[i] + 1] += 1
    for t in range(wide * deep):
        first[t + 1] += first[t]
    fill, by_tile = first[:-1].copy(), np.empty((len(places), 3), np.float32)
    for i in range(len(places)):
        for axis in range(3):
            by_tile[fill[tile[i]], axis] = places[i, axis]
        fill[tile[i]] += 1
    return Tiles(by_tile, first, low, edge, deep)


@compiled
def cells_in_box(tiles: Tiles, low: Places, high: Places) -> Cells:
    """Sort the places strictly within bounds (3,), metres, into cells over the ground."""
    wide = (len(tiles.first) - 1) // tiles.deep
    edge = max(_CELL_M, max(high[0] - low[0], high[1] - low[1]) / _MOST_CELLS)
    rows, deep = int((high[0] - low[0]) / edge) + 1, int((high[1] - low[1]) / edge) + 1
    first = np.zeros(rows * deep + 1, np.int32)
    begin, end = np.empty(2, np.int64), np.empty(2, np.int64)
    for axis in range(2):
        begin[axis] = max(0.0, (low[axis] - tiles.low_m[axis]) / tiles.edge_m)
        last = (high[axis] - tiles.low_m[axis]) / tiles.edge_m
        end[axis] = max(0.0, min(last + 1.0, np.float64(wide if axis == 0 else tiles.deep)))
    most = 0
    for row in range(begin[0], end[0]):
        if begin[1] < end[1]:
            run = row * tiles.deep
            most += tiles.first[run + end[1]] - tiles.first[run + begin[1]]
    inside, cell, count = np.empty((most, 2), np.float64), np.empty(most, np.int32), 0
    for row in range(begin[0], end[0]):
        if begin[1] >= end[1]:
            continue
        run = row * tiles.deep
        for i in range(tiles.first[run + begin[1]], tiles.first[run + end[1]]):
            x, y = np.float64(tiles.places_m[i, 0]), np.float64(tiles.places_m[i, 1])
            if not (low[0] < x < high[0] and low[1] < y < high[1]):
                continue
            if low[2] < tiles.places_m[i, 2] < high[2]:
                inside[count, 0], inside[count, 1] = x, y
                cell[count] = int((x - low[0]) / edge) * deep + int((y - low[1]) / edge)
                first[cell[count] + 1] += 1
                count += 1
    for c in range(rows * deep):
        first[c + 1] += first[c]
    fill, by_cell = first[:-1].copy(), np.empty((count, 2), np.float64)
    for i in range(count):
        by_cell[fill[cell[i]], 0], by_cell[fill[cell[i]], 1] = inside[i, 0], inside[i, 1]
        fill[cell[i]] += 1
    return Cells(by_cell, first, low[:2].copy(), edge, deep)


@compiled
def misfits(shape: Places, shifts: Places, seen: Cells, farthest: float, bulk: float) -> Places:
    """Return the mean distance of a shape's nearest points to observed places, for each shift.

    Args:
        shape: (P, 2) points of the shape, metres, P >= 1.
        shifts: (V, 2) translations of the shape, metres.
        seen: Places that the shape is compared to.
        farthest: Upper bound of the distance of a point, metres.
        bulk: Share of the points, the nearest, in the mean; at least one point.

    Returns:
        (V,) mean distances, metres.
    """
    counted = max(1, int(bulk * len(shape)))
    means, away = np.empty(len(shifts), np.float64), np.empty(len(shape), np.float64)
    for v in range(len(shifts)):
        for p in range(len(shape)):
            x, y = shape[p, 0] + shifts[v, 0], shape[p, 1] + shifts[v, 1]
            away[p] = _nearest(x, y, seen, farthest)
        away.sort()
        total = 0.0
        for p in range(counted):
            total += away[p]
        means[v] = total / counted
    return means


@compiled
def _nearest(x: float, y: float, seen: Cells, farthest: float) -> float:
    """Return the distance to the nearest place, at most `farthest`."""
    rows = (len(seen.first) - 1) // seen.deep
    along, aside = x - seen.low_m[0], y - seen.low_m[1]
    own = int(np.floor(along / seen.edge_m))
    least, reach = farthest * farthest, farthest
    for step in range(2 * int(np.ceil(farthest / seen.edge_m)) + 1):
        row = own + (step + 1) // 2 * (1 if step % 2 else -1)
        short = max(row * seen.edge_m - along, along - (row + 1) * seen.edge_m)
        if row < 0 or row >= rows or short >= reach:
            continue
        begin = max(0, int(np.floor((aside - reach) / seen.edge_m)))
        end = min(seen.deep, int(np.floor((aside + reach) / seen.edge_m)) + 1)
        if begin >= end:
            continue
        for i in range(seen.first[row * seen.deep + begin], seen.first[row * seen.deep + end]):
            dx, dy = x - seen.places_m[i, 0], y - seen.places_m[i, 1]
            least = min(least, dx * dx + dy * dy)
        reach = np.sqrt(least)
    return float(reach)
