"""What one frame's proof of a motion is worth: a whole one, or half of one.

Free space and registration err in single frames, at the rims of things: half a proof takes another
frame to say that a thing moves, and an error is seldom made twice.
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
"""As much as a wheel shows, 0.6 by 0.6 m: all that takes part in traffic has more than one."""

SMALL_VOXELS: Final = 12
"""What shows less, or has fewer voxels, may be the rim of a shadow, or the end of a thing that just
came into sight."""

TAKEN_VOTES: Final = 1.0
TAKEN_FREE_SHARE: Final = 0.3
"""Something was there where it is, and little of it was seen through: a wall that seems to slide
along itself, a bush that lost some leaves; or what is slow, or long, or drives close behind."""

LINE_M: Final = 0.25
LINE_LENGTH_M: Final = 1.2
"""Seen from above next to no breadth: the upper edge of a wall, a rail, a kerb, which a beam meets
in one frame and passes over in the next. A car has a second side, or a roof."""


def proves_whole(
    points_m: Points,
    clusters: Clusters,
    votes: Votes,
    *,
    centre_m: NDArray[np.floating],
    table: BeamTable,
) -> Mask:
    """Say of which clusters one frame proves a motion whole.

    Args:
        points_m: (V, 3) voxel centroids off the ground, odom space.
        clusters: K sets of them.
        votes: What free space says about the voxels.
        centre_m: (3,) the sensor, odom space.
        table: Beams of the sensor, which say how many voxels a thing can show.

    Returns:
        (K,) bool; of the others it is half a proof.
    """
    about_m = points_m - centre_m.astype(np.float32)
    large: Mask = clusters.sizes >= _voxels_of(SMALL_M2, about_m, clusters, table)
    return large & ~_were_there(clusters, votes) & ~_are_lines(about_m, clusters)


def _were_there(clusters: Clusters, votes: Votes) -> Mask:
    free_share = clusters.count(votes.seen_through) / np.maximum(clusters.sizes, 1)
    there: Mask = (clusters.mean(votes.occupied) > TAKEN_VOTES) & (free_share < TAKEN_FREE_SHARE)
    return there


def _are_lines(about_m: Points, clusters: Clusters) -> Mask:
    """(K,) whether a cluster, seen from above, is long and next to no breadth."""
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


def _voxels_of(
    area_m2: float, about_m: Points, clusters: Clusters, table: BeamTable
) -> NDArray[np.float64]:
    """(K,) how many voxels an area shows as far away as each cluster: as many as beams reach it."""
    range_m = clusters.mean(np.linalg.norm(about_m, axis=1))
    gaps = np.diff(table.tangents)
    up_m = np.maximum(range_m * (np.median(gaps) if len(gaps) else 0.0), VOXEL_M)
    across_m = np.maximum(range_m * 2.0 * np.pi / COLUMNS, VOXEL_M)
    return np.maximum(area_m2 / (up_m * across_m), SMALL_VOXELS)
