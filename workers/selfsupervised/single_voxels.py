"""Single voxels of movers: voxels outside every cluster, next to something that moves."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from workers.free_space import Votes
from workers.points.clusters import from_labels
from workers.points.neighbours import build_grid, nearest_indices
from workers.points.step_names import step
from workers.selfsupervised.motion import ClusterMotions
from workers.selfsupervised.occlusion_fragments import OCCUPIED_BEFORE_VOTES, REACH_M
from workers.selfsupervised.voxel_clusters import REACH_M as BODY_REACH_M


@step("specks")
def assign_single_voxels(
    points_m: Points,
    found: ClusterMotions,
    moves: Mask,
    votes: Votes,
    *,
    centre_m: NDArray[np.floating],
) -> ClusterMotions:
    """Assign voxels outside every cluster to the mover next to them.

    The largest gap is that between points of one body if nothing was there before. It is that
    between fragments of one object where earlier frames saw through.

    Args:
        points_m: (V, 3) voxel centroids off the ground, odom space.
        found: Their clusters and motions.
        moves: (K,) clusters that move.
        votes: Free-space votes on the voxels.
        centre_m: (3,) the sensor, odom space.

    Returns:
        The same clusters, some with a few voxels more.
    """
    of_voxel = found.clusters.of_point
    moving = np.flatnonzero(found.clusters.member_mask(moves))
    candidates = np.flatnonzero(of_voxel < 0)
    if len(moving) == 0 or len(candidates) == 0:
        return found
    grid = build_grid(points_m[moving], centre_m)
    nearest = nearest_indices(grid, points_m[candidates], REACH_M)
    candidates, nearest = candidates[nearest >= 0], nearest[nearest >= 0]
    apart_m = np.linalg.norm(points_m[candidates] - grid.points_m[nearest], axis=1)
    of_body = (apart_m < BODY_REACH_M) & (votes.occupied[candidates] <= OCCUPIED_BEFORE_VOTES)
    belongs = votes.seen_through[candidates] | of_body
    labels = of_voxel.copy()
    labels[candidates[belongs]] = of_voxel[moving[grid.order[nearest[belongs]]]]
    return replace(found, clusters=from_labels(labels))
