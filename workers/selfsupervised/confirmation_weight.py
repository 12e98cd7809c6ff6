"""Confirmation weight: the evidence of one frame for a motion counts in full or by half.

Free space and registration err in single frames, at the rims of objects. A motion confirmed by half
needs another frame before its cluster is labelled dynamic; an error seldom occurs twice.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from workers.free_space import Votes
from workers.lidar.beam_image import COLUMNS
from workers.lidar.beam_table import BeamTable
from workers.points.clusters import Clusters
from workers.points.voxels import VOXEL_M

SMALL_M2: Final = 0.36
"""Visible area of a wheel, m², 0.6 by 0.6 m: every road user shows more."""

SMALL_VOXELS: Final = 12
"""Voxels below which a cluster may be the rim of a shadow.

It may also be the end of an object that has just come into view."""

OCCUPIED_VOTES: Final = 1.0
OCCUPIED_FREE_SHARE: Final = 0.3
"""Mean occupied votes above which a place was taken before, and free share up to which it still is.

Such clusters are walls that seem to slide along themselves and bushes that lost some leaves. Slow
and long objects, and those that follow another closely, look the same."""

LINE_M: Final = 0.25
LINE_LENGTH_M: Final = 1.2
"""Breadth below which, and length above which, a cluster seen from above is a line.

The upper edge of a wall, a rail or a kerb is a line: a beam meets it in one frame and passes over
it in the next. A car has a second side, or a roof."""


def confirms_in_full(
    points_m: Points,
    clusters: Clusters,
    votes: Votes,
    *,
    centre_m: NDArray[np.floating],
    table: BeamTable,
) -> Mask:
    """Return the clusters whose motion one frame confirms in full.

    Args:
        points_m: (V, 3) voxel centroids off the ground, odom space.
        clusters: K sets of them.
        votes: Free-space votes on the voxels.
        centre_m: (3,) the sensor, odom space.
        table: Beams of the sensor, which determine how many voxels an object can show.

    Returns:
        (K,) bool; the other clusters are confirmed by half.
    """
    about_m = points_m - centre_m.astype(np.float32)
    large: Mask = clusters.sizes >= _visible_voxels(SMALL_M2, about_m, clusters, table)
    return large & ~_were_occupied(clusters, votes) & ~_are_lines(about_m, clusters)


def _were_occupied(clusters: Clusters, votes: Votes) -> Mask:
    free_share = clusters.count(votes.seen_through) / np.maximum(clusters.sizes, 1)
    occupied: Mask = (clusters.mean(votes.occupied) > OCCUPIED_VOTES) & (
        free_share < OCCUPIED_FREE_SHARE
    )
    return occupied


def _are_lines(about_m: Points, clusters: Clusters) -> Mask:
    """Return (K,) clusters that are long and almost without breadth, seen from above."""
    x, y = about_m[:, :2].T.astype(np.float64)
    mean_x, mean_y = clusters.mean(x), clusters.mean(y)
    of_x = clusters.mean(x * x) - mean_x**2
    of_y = clusters.mean(y * y) - mean_y**2
    of_both = clusters.mean(x * y) - mean_x * mean_y
    middle, apart = (of_x + of_y) / 2, np.hypot((of_x - of_y) / 2, of_both)
    length_m, breadth_m = (  # of an even line with such a variance
        np.sqrt(12.0 * np.maximum(each, 0.0)) for each in (middle + apart, middle - apart)
    )
    lines: Mask = (breadth_m < LINE_M) & (length_m > LINE_LENGTH_M)
    return lines


def _visible_voxels(
    area_m2: float, about_m: Points, clusters: Clusters, table: BeamTable
) -> NDArray[np.float64]:
    """Return (K,) voxels that an area shows at the range of each cluster: one per beam on it."""
    range_m = clusters.mean(np.linalg.norm(about_m, axis=1))
    gaps = np.diff(table.tangents)
    up_m = np.maximum(range_m * (np.median(gaps) if len(gaps) else 0.0), VOXEL_M)
    across_m = np.maximum(range_m * 2.0 * np.pi / COLUMNS, VOXEL_M)
    return np.maximum(area_m2 / (up_m * across_m), SMALL_VOXELS)
