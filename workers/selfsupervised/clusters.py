"""Connected components of a cloud: clusters, without a minimum of neighbours."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.selfsupervised.compiled import compiled
from workers.selfsupervised.neighbours import CELL_XY_M, CELL_Z_M, PointGrid, build_grid, cell_along


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """Disjoint sets of points, as lists of members.

    Attributes:
        of_point: (N,) cluster of each point, -1 for those in none.
        members: (M,) point indices, cluster after cluster, ascending inside each.
        start: (K + 1,) where each cluster begins in `members`.
    """

    of_point: NDArray[np.int32]
    members: NDArray[np.int32]
    start: NDArray[np.int32]

    def __len__(self) -> int:
        """Count the clusters."""
        return len(self.start) - 1

    @property
    def sizes(self) -> NDArray[np.int32]:
        """(K,) members of each cluster."""
        return np.diff(self.start)

    def of(self, cluster: int) -> NDArray[np.int32]:
        """(n,) members of one cluster."""
        return self.members[self.start[cluster] : self.start[cluster + 1]]

    def member_mask(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(N,) points that belong to a chosen cluster, of (K,)."""
        mask = np.zeros(len(self.of_point), np.bool_)
        inside = self.of_point >= 0
        mask[inside] = chosen[self.of_point[inside]]
        return mask

    def keep(self, chosen: NDArray[np.bool_]) -> "Clusters":
        """Only the chosen clusters, of (K,), numbered anew."""
        return from_labels(np.where(self.member_mask(chosen), self.of_point, -1).astype(np.int32))

    def count(self, mask: NDArray[np.bool_]) -> NDArray[np.int64]:
        """(K,) members of each cluster for which a mask over the points holds."""
        inside = self.of_point[mask]
        return np.bincount(inside[inside >= 0], minlength=len(self))

    def mean(self, values: NDArray[np.generic]) -> NDArray[np.float64]:
        """(K,) mean of a value over the members of each cluster, of (N,)."""
        inside = self.of_point >= 0
        total = np.bincount(self.of_point[inside], values[inside], minlength=len(self))
        return total / np.maximum(self.sizes, 1)


def connected(
    points_m: Points,
    *,
    reach_m: float,
    min_points: int,
    among: NDArray[np.bool_] | None = None,
    groups: NDArray[np.int32] | None = None,
) -> Clusters:
    """Join points that are closer than a reach, directly or through others.

    Args:
        points_m: (N, 3) metres.
        reach_m: Points nearer than this are joined.
        min_points: Smaller sets are dropped.
        among: (N,) which points take part; all by default.
        groups: (N,) only points of one group are joined; one group by default.
    """
    n = len(points_m)
    index = np.arange(n, dtype=np.int32) if among is None else np.flatnonzero(among)
    own = np.zeros(len(index), np.int32) if groups is None else groups[index].astype(np.int32)
    if len(index) == 0:
        return from_labels(np.full(n, -1, np.int32))
    chosen = points_m[index]
    grid = build_grid(chosen, chosen.mean(axis=0))
    root = _roots(grid, own[grid.order], np.float32(reach_m))
    of_chosen = np.empty(len(index), np.int32)
    of_chosen[grid.order] = grid.order[root]
    size = np.bincount(of_chosen, minlength=len(index))
    of_chosen[size[of_chosen] < min_points] = -1
    labels = np.full(n, -1, np.int32)
    labels[index] = of_chosen
    return from_labels(labels)


def from_labels(labels: NDArray[np.int32]) -> Clusters:
    """Collect the members of arbitrary labels, numbered anew in their order; -1 is none."""
    inside = np.flatnonzero(labels >= 0)
    found, of_inside = np.unique(labels[inside], return_inverse=True)
    of_point = np.full(len(labels), -1, np.int32)
    of_point[inside] = of_inside
    members = inside[np.argsort(of_inside, kind="stable")].astype(np.int32)
    start = np.zeros(len(found) + 1, np.int32)
    np.cumsum(np.bincount(of_inside, minlength=len(found)), out=start[1:])
    return Clusters(of_point, members, start)


@compiled
def _find(parent: NDArray[np.int32], i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@compiled
def _roots(grid: PointGrid, group: NDArray[np.int32], reach: np.float32) -> NDArray[np.int32]:
    points, start, origin, shape = grid.points_m, grid.start, grid.origin_m, grid.shape
    n = len(points)
    parent = np.arange(n).astype(np.int32)
    for i in range(n):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        z0 = cell_along(z - reach, origin[2], CELL_Z_M, shape[2])
        z1 = cell_along(z + reach, origin[2], CELL_Z_M, shape[2])
        root = _find(parent, i)
        for cx in range(
            cell_along(x - reach, origin[0], CELL_XY_M, shape[0]),
            cell_along(x + reach, origin[0], CELL_XY_M, shape[0]) + 1,
        ):
            for cy in range(
                cell_along(y - reach, origin[1], CELL_XY_M, shape[1]),
                cell_along(y + reach, origin[1], CELL_XY_M, shape[1]) + 1,
            ):
                column = (cx * shape[1] + cy) * shape[2]
                for j in range(start[column + z0], start[column + z1 + 1]):
                    if j >= i:
                        break
                    if parent[j] == root or group[j] != group[i]:
                        continue
                    dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
                    if dx * dx + dy * dy + dz * dz < reach * reach:
                        other = _find(parent, j)
                        if other != root:
                            # the smaller index becomes the root: independent of visiting order
                            parent[max(root, other)] = min(root, other)
                            root = min(root, other)
    for i in range(n):
        parent[i] = _find(parent, i)
    return parent
