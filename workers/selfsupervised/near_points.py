"""Near points: those closer to the sensor than points are judged, next to a mover.

Within 2.5 m are the returns of the car itself, which are not judged. A lorry in the next lane
passes at 2.2 m: its points there continue those that are judged.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask
from workers.lidar.beam_table import MIN_RANGE_M
from workers.lidar.preprocessing import MAX_HEIGHT_M, PreprocessedFrame
from workers.points.clusters import Clusters, connected
from workers.points.neighbours import build_grid, nearest_indices
from workers.points.point_kernels import judged_rows, moved_rows
from workers.points.step_names import step
from workers.points.voxels import voxelize
from workers.selfsupervised.voxel_clusters import REACH_M

_BODY_M: Final = 1.2
"""Horizontal range within which every return is of the car itself, metres: half its width and its
mirrors."""

_MIN_TOUCHING_VOXELS: Final = 3


@step("near points")
def continue_movers(
    prepared: PreprocessedFrame, clusters: Clusters, dynamic: Mask
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Find the points nearer than points are judged that continue a mover.

    Near points within 0.5 m of each other are one piece. It belongs to a mover if most of its
    places that touch judged ones touch a mover.

    Args:
        prepared: The frame.
        clusters: Clusters of its voxels.
        dynamic: (K,) clusters that move.

    Returns:
        (P,) rows of `prepared.points_m`, and (P,) the mover's cluster of each.
    """
    nothing = np.zeros(0, np.int64), np.zeros(0, np.int32)
    centre_m = prepared.odom_from_beams[:3, 3]
    places = prepared.voxels.centroids_m
    apart_m = places[:, :2] - centre_m[:2].astype(np.float32)
    edge_m = np.float32(MIN_RANGE_M + REACH_M)
    edge = (np.einsum("vi,vi->v", apart_m, apart_m) < edge_m**2) & (clusters.of_point >= 0)
    judged = np.flatnonzero(edge)
    moves = dynamic[clusters.of_point[judged]]
    if not moves.any():
        return nothing
    rows = judged_rows(prepared.points_m, prepared.ground, _BODY_M, MIN_RANGE_M, MAX_HEIGHT_M)
    if len(rows) == 0:
        return nothing
    near = voxelize(moved_rows(prepared.points_m, rows, prepared.odom_from_beams))
    pieces = connected(near.centroids_m, reach_m=REACH_M, min_points=1)
    grid = build_grid(places[judged], centre_m)
    nearest = nearest_indices(grid, near.centroids_m, REACH_M)
    touching = nearest >= 0
    touches_mover = touching.copy()
    touches_mover[touching] = moves[grid.order[nearest[touching]]]
    count = pieces.count(touches_mover)
    belongs = (count >= _MIN_TOUCHING_VOXELS) & (2 * count > pieces.count(touching))
    chosen = pieces.member_mask(belongs)[near.of_point]
    if not chosen.any():
        return nothing
    of_piece = np.zeros(len(pieces), np.int32)
    touched = judged[grid.order[nearest[touches_mover]]]
    of_piece[pieces.of_point[touches_mover]] = clusters.of_point[touched]
    return rows[chosen], of_piece[pieces.of_point[near.of_point[chosen]]]
