"""Clusters as connected components of a cloud, without a minimum of neighbours."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.points.compiled import compiled
from workers.points.components import components


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """Disjoint sets of points, as lists of members.

    Attributes:
        of_point: (N,) cluster of each point, -1 for those in none.
        members: (M,) point indices, cluster after cluster, ascending inside each.
        start: (K + 1,) first member of each cluster in `members`.
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
        """Return (n,) members of one cluster."""
        return self.members[self.start[cluster] : self.start[cluster + 1]]

    def member_mask(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return (N,) the points that belong to a selected cluster, of (K,)."""
        return _member_mask(self.of_point, chosen)

    def keep(self, chosen: NDArray[np.bool_]) -> "Clusters":
        """Return the selected clusters, of (K,), renumbered."""
        return from_labels(np.where(self.member_mask(chosen), self.of_point, -1).astype(np.int32))

    def count(self, mask: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Count (K,) the members of each cluster that a mask over the points selects."""
        return _counted(self.of_point, mask, len(self))

    def mean(self, values: NDArray[np.generic]) -> NDArray[np.float64]:
        """Return (K,) the mean of a value over the members of each cluster, of (N,)."""
        return _summed(self.of_point, values, len(self)) / np.maximum(self.sizes, 1)


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
        among: (N,) points that take part; all by default.
        groups: (N,) only points of one group are joined; one group by default.
    """
    n = len(points_m)
    index = np.arange(n, dtype=np.int32)
    if among is not None:
        index = index[among]
    own = np.zeros(len(index), np.int32) if groups is None else groups[index].astype(np.int32)
    root = components(points_m, index, own, np.float32(reach_m))
    size = np.bincount(root, minlength=len(index))
    root[size[root] < min_points] = -1
    labels = np.full(n, -1, np.int32)
    labels[index] = root
    return from_labels(labels)


def from_labels(labels: NDArray[np.int32]) -> Clusters:
    """Collect the members of arbitrary labels, renumbered in their order; -1 is none."""
    return Clusters(*_collected(labels.astype(np.int32, copy=False)))


@compiled
def _collected(
    labels: NDArray[np.int32],
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Count, renumber and sort by counting, since labels are small integers."""
    n, most = len(labels), -1
    for i in range(n):
        most = max(most, labels[i])
    size = np.zeros(most + 1, np.int32)
    for i in range(n):
        if labels[i] >= 0:
            size[labels[i]] += 1
    number = np.empty(most + 1, np.int32)
    count = 0
    for label in range(most + 1):
        number[label] = count
        count += size[label] > 0
    start = np.zeros(count + 1, np.int32)
    for label in range(most + 1):
        if size[label] > 0:
            start[number[label] + 1] = start[number[label]] + size[label]
    fill = start[:-1].copy()
    of_point = np.full(n, -1, np.int32)
    members = np.empty(start[count], np.int32)
    for i in range(n):
        if labels[i] >= 0:
            k = number[labels[i]]
            of_point[i] = k
            members[fill[k]] = i
            fill[k] += 1
    return of_point, members, start


@compiled
def _member_mask(of_point: NDArray[np.int32], chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    mask = np.zeros(len(of_point), np.bool_)
    for i in range(len(of_point)):
        k = of_point[i]
        if k >= 0:
            mask[i] = chosen[k]
    return mask


@compiled
def _counted(of_point: NDArray[np.int32], mask: NDArray[np.bool_], count: int) -> NDArray[np.int64]:
    counts = np.zeros(count, np.int64)
    for i in range(len(of_point)):
        k = of_point[i]
        if k >= 0 and mask[i]:
            counts[k] += 1
    return counts


@compiled
def _summed(
    of_point: NDArray[np.int32], values: NDArray[np.generic], count: int
) -> NDArray[np.float64]:
    total = np.zeros(count, np.float64)
    for i in range(len(of_point)):
        k = of_point[i]
        if k >= 0:
            total[k] += values[i]
    return total
