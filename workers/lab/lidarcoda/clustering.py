"""Points of one annotation: those in the frustum of its box, clustered twice.

DBSCAN and mean shift each choose one cluster as the object; a person grades both afterwards.
Source: the paper's notebooks for LidarCODA, step B.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.lab.lidarcoda.cameras import Projected

NEIGHBOUR_M: Final = 0.15
"""Neighbour distance of DBSCAN, metres."""

MIN_POINTS: Final = 6
"""Neighbours, itself included, of a core point of DBSCAN."""

HEIGHT_WEIGHT: Final = 0.1
"""Factor on height before DBSCAN; the beams of a lidar are far apart vertically."""

QUANTILE: Final = 0.3
"""Quantile of the pairwise distances that gives the bandwidth of mean shift."""

FALLBACK_BANDWIDTH: Final = 1.0
"""Bandwidth where the estimate is zero, metres."""

NEAR_CENTRE: Final = 5
"""Points nearest to the centre of the box; the object's cluster is that of the closest of them."""

DECIMALS: Final = 3
"""Decimals of stored coordinates, metres; the published files match points by them."""


@dataclass(frozen=True, slots=True, eq=False)
class ClusteredBox:
    """Points in the box of one annotation.

    Attributes:
        index: (N,) int32 rows of the cloud: the identity of each point.
        columns: (N, 7) float32 as published: x, y, z in metres, DBSCAN label, +1 where DBSCAN chose
            the point else -1, mean shift label, the same choice of mean shift.
    """

    index: NDArray[np.int32]
    columns: NDArray[np.float32]

    @property
    def dbscan(self) -> NDArray[np.int8]:
        """(N,) choice of DBSCAN: +1 of the object, -1 not."""
        return self.columns[:, 4].astype(np.int8)

    @property
    def mean_shift(self) -> NDArray[np.int8]:
        """(N,) choice of mean shift: +1 of the object, -1 not."""
        return self.columns[:, 6].astype(np.int8)


def cluster_box(seen: Projected, box_px: tuple[float, float, float, float]) -> ClusteredBox:
    """Cluster the points whose pixels lie in a box, both ways.

    A chosen noise label of DBSCAN marks all noise points, and mean shift runs on five columns
    (coordinates, DBSCAN's label and choice), both as published.

    Args:
        seen: Points in front of the camera.
        box_px: x and y of the upper left corner, width and height, pixels; borders are inside.

    Returns:
        The points in the order of the cloud; none if no point is in the box.
    """
    left, top, width, height = box_px
    u, v = seen.pixels[:, 0], seen.pixels[:, 1]
    inside = (u >= left) & (u <= left + width) & (v >= top) & (v <= top + height)
    index = seen.index[inside].astype(np.int32)
    if not len(index):
        return ClusteredBox(index, np.empty((0, 7), np.float32))
    xyz = np.round(seen.restored_m[inside], DECIMALS)
    centre = np.hypot(u[inside] - (left + width / 2), v[inside] - (top + height / 2))
    near = np.argsort(centre, kind="stable")[:NEAR_CENTRE]
    chosen = near[np.argmin(seen.depth_m[inside][near])]
    dbscan = _dbscan(xyz)
    by_dbscan = np.where(dbscan == dbscan[chosen], 1, -1)
    shifted = _mean_shift(np.column_stack((xyz, dbscan, by_dbscan)))
    by_shift = np.where(shifted == shifted[chosen], 1, -1)
    columns = np.column_stack((xyz, dbscan, by_dbscan, shifted, by_shift)).astype(np.float32)
    return ClusteredBox(index, columns)


def _dbscan(xyz: NDArray[np.float64]) -> NDArray[np.int64]:
    from sklearn.cluster import DBSCAN

    found = DBSCAN(eps=NEIGHBOUR_M, min_samples=MIN_POINTS).fit(xyz * (1, 1, HEIGHT_WEIGHT))
    return np.asarray(found.labels_, np.int64)


def _mean_shift(rows: NDArray[np.float64]) -> NDArray[np.int64]:
    from sklearn.cluster import MeanShift, estimate_bandwidth

    bandwidth = float(estimate_bandwidth(rows, quantile=QUANTILE)) or FALLBACK_BANDWIDTH
    return np.asarray(MeanShift(bandwidth=bandwidth).fit(rows).labels_, np.int64)
