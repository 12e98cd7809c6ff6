"""Borders of the objects of a frame: the points onto which a model's labels bleed."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from schemas.arrays import Mask, Points

REACH_M: Final = 1.2
"""Distance from an object within which a point belongs to its surroundings, metres."""

BEHIND_RAD: Final = float(np.radians(0.8))
"""Angle to an object's outline within which a point behind it belongs to its shadow, radians."""

BEHIND_M: Final = 0.5
"""Distance behind an object from which a point is in its shadow, metres."""

INSIDE_M: Final = 0.3
"""Distance to the surroundings within which an object's point lies at its border, metres."""

_CELL_M: Final = REACH_M

Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Points onto which a label may spread, and the point that each takes it from.

    Attributes:
        index: (K,) rows of the points.
        source: (K,) rows of the points whose label they would take.
        away: (K,) distance between the two, metres or radians.
    """

    index: Index
    source: Index
    away: NDArray[np.float32]

    def where(self, chosen: Mask) -> "Spread":
        """Return the rows where `chosen`, (K,), is true."""
        return Spread(self.index[chosen], self.source[chosen], self.away[chosen])


@dataclass(frozen=True, slots=True, eq=False)
class Borders:
    """Borders of all objects of a frame; they depend on the points and not on labels.

    Attributes:
        around: Points outside the objects within `REACH_M`; the sources are objects' points.
        behind: Points behind an object, close to its outline as seen from the sensor; metres of
            arc are radians here.
        inside: Objects' points within `INSIDE_M` of a point outside, which is the source.
    """

    around: Spread
    behind: Spread
    inside: Spread


def borders_of(points_m: Points, thing: NDArray[np.integer]) -> Borders:
    """Find the borders of the objects of a frame.

    Args:
        points_m: (N, 3) points in sensor space.
        thing: (N,) number of the object that a point belongs to, -1 none.
    """
    range_m = np.linalg.norm(points_m, axis=1)
    mine = np.flatnonzero((thing >= 0) & (range_m > 0))
    rest = np.flatnonzero((thing < 0) & (range_m > 0))
    if not len(mine) or not len(rest):
        return Borders(_NOTHING, _NOTHING, _NOTHING)
    near = rest[_near_cells(points_m[mine], points_m[rest])]
    objects = cKDTree(points_m[mine], balanced_tree=False, compact_nodes=False)
    around = _nearest(objects, mine, points_m[near], near, REACH_M)
    inside = _NOTHING
    if len(near):
        others = cKDTree(points_m[near], balanced_tree=False, compact_nodes=False)
        inside = _nearest(others, near, points_m[mine], mine, INSIDE_M)
    return Borders(around, _shadow(points_m, range_m, mine, rest), inside)


def _nearest(tree: cKDTree, sources: Index, places_m: Points, index: Index, most: float) -> Spread:
    away, which = tree.query(places_m, distance_upper_bound=most)
    found = np.isfinite(away)
    return Spread(index[found], sources[which[found]], away[found].astype(np.float32))


def _near_cells(objects_m: Points, others_m: Points) -> Mask:
    """Return the points in a cell of objects, or in a neighbouring one, seen from above."""
    low = np.floor(objects_m[:, :2].min(axis=0) / _CELL_M).astype(np.int64) - 1
    high = np.floor(objects_m[:, :2].max(axis=0) / _CELL_M).astype(np.int64) + 1
    taken = np.zeros(high - low + 1, np.bool_)
    x, y = (np.floor(objects_m[:, :2] / _CELL_M).astype(np.int64) - low).T
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            taken[x + dx, y + dy] = True
    cells = np.floor(others_m[:, :2] / _CELL_M).astype(np.int64) - low
    inside = ((cells >= 0) & (cells < taken.shape)).all(axis=1)
    near = np.zeros(len(others_m), np.bool_)
    near[inside] = taken[cells[inside, 0], cells[inside, 1]]
    return near


def _shadow(points_m: Points, range_m: NDArray[np.float32], mine: Index, rest: Index) -> Spread:
    ways = points_m[mine] / range_m[mine, None]
    others = points_m[rest] / range_m[rest, None]
    azimuth = np.arctan2(ways[:, 1], ways[:, 0])
    steps = round(2 * np.pi / BEHIND_RAD)
    taken = np.zeros(steps + 2, np.bool_)
    column = ((azimuth + np.pi) / (2 * np.pi) * steps).astype(np.int64) + 1
    for step in (-1, 0, 1):
        taken[np.clip(column + step, 0, steps + 1)] = True
    theirs = np.arctan2(others[:, 1], others[:, 0])
    close = taken[((theirs + np.pi) / (2 * np.pi) * steps).astype(np.int64) + 1]
    close &= range_m[rest] > range_m[mine].min() + BEHIND_M
    tree = cKDTree(ways, balanced_tree=False, compact_nodes=False)
    found = _nearest(tree, mine, others[close], rest[close], BEHIND_RAD)
    return found.where(range_m[found.index] > range_m[found.source] + BEHIND_M)


_NOTHING: Final = Spread(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.float32))
