"""From what is known of clusters and voxels to one label, confidence and cluster per point."""

from typing import Final

import numpy as np

from schemas.arrays import Mask
from schemas.frame import LidarFrame
from schemas.labels import FrameHealth, FrameLabels, MotionLabel
from workers.geometry.se3 import transform
from workers.selfsupervised.beam_table import MIN_RANGE_M
from workers.selfsupervised.free_space import Votes
from workers.selfsupervised.motion import ClusterMotions
from workers.selfsupervised.neighbours import build_grid, nearest_indices
from workers.selfsupervised.prepare import MAX_RANGE_M, Prepared
from workers.selfsupervised.steps import step
from workers.selfsupervised.tracker import Tracked

AGREED: Final = 0.95
"""Registration and free space say the same: measured point precision .999 and .965 to .99."""

ALONE: Final = 0.7
"""Only one of them has an opinion, or the frames before have."""

GROUND: Final = 0.9
"""Ground does not move; nine in ten points called ground are."""

REATTACH_M: Final = 0.2
"""Ground removal takes the lowest hand's breadth of what stands on it; movers get it back."""


def nothing_known(
    frame: LidarFrame, prepared: Prepared | None = None, *, health: FrameHealth
) -> FrameLabels:
    """Answer UNKNOWN for everything; the ground is still the ground where it was found."""
    n = len(frame)
    ground = np.zeros(n, np.bool_)
    if prepared is not None:
        ground[prepared.valid_index[prepared.ground]] = True
    return FrameLabels(
        labels=np.full(n, MotionLabel.UNKNOWN, np.uint8),
        confidence=np.zeros(n, np.float16),
        ground_mask=ground,
        cluster=np.full(n, -1, np.int32),
        cluster_velocity_m_per_s=np.zeros((0, 3), np.float32),
        confirmed=np.zeros(n, np.bool_),
        health=health,
    )


@step("answer")
def to_labels(
    frame: LidarFrame,
    prepared: Prepared,
    found: ClusterMotions,
    tracked: Tracked,
    votes: Votes,
) -> FrameLabels:
    """Label every point of a frame.

    DYNAMIC: its cluster moves, as the frames so far prove. STATIC: ground, or its cluster fits
    where it was, or frames of the last second saw something there more often than not. UNKNOWN: no
    witness, or a motion that is not proved; whatever is invalid, too near, too far or too high.
    """
    n = len(frame)
    labels = np.full(n, MotionLabel.UNKNOWN, np.uint8)
    confidence = np.zeros(n, np.float16)
    cluster = np.full(n, -1, np.int32)

    range_m = np.hypot(prepared.points_m[:, 0], prepared.points_m[:, 1])
    ground = prepared.ground & (range_m > MIN_RANGE_M) & (range_m < MAX_RANGE_M)
    clusters = found.clusters
    reattached, to_confirmed = _reattached(
        prepared,
        clusters.member_mask(tracked.dynamic),
        clusters.member_mask(tracked.confirmed),
        ground,
    )
    ground_index = prepared.valid_index[ground & ~reattached]
    labels[ground_index] = MotionLabel.STATIC
    confidence[ground_index] = GROUND
    reattached_index = prepared.valid_index[reattached]
    labels[reattached_index] = MotionLabel.DYNAMIC
    confidence[reattached_index] = ALONE

    moves = clusters.member_mask(tracked.dynamic)
    both = moves & clusters.member_mask(found.registered & found.seen_through)
    stands = clusters.member_mask(found.still & ~found.proved) & ~moves
    doubted = clusters.member_mask(found.unconfirmed | found.proved)
    was_there = ~moves & (votes.occupied > votes.free) & ~doubted
    voxel_labels = np.full(len(moves), MotionLabel.UNKNOWN, np.uint8)
    voxel_labels[stands | was_there] = MotionLabel.STATIC
    voxel_labels[moves] = MotionLabel.DYNAMIC
    voxel_confidence = np.where(both | (stands & was_there), AGREED, ALONE).astype(np.float16)
    voxel_confidence[voxel_labels == MotionLabel.UNKNOWN] = 0.0

    point_index = prepared.valid_index[prepared.judged_index]
    of_point = prepared.voxels.of_point
    labels[point_index] = voxel_labels[of_point]
    confidence[point_index] = voxel_confidence[of_point]
    cluster[point_index] = clusters.of_point[of_point]
    confirmed = np.zeros(n, np.bool_)
    confirmed[point_index] = clusters.member_mask(tracked.confirmed)[of_point]
    confirmed[prepared.valid_index[to_confirmed]] = True

    ground_mask = np.zeros(n, np.bool_)
    ground_mask[prepared.valid_index[prepared.ground & ~reattached]] = True
    velocity = np.where(tracked.dynamic[:, None], tracked.velocity_m_per_s, 0.0)
    return FrameLabels(
        labels=labels,
        confidence=confidence,
        ground_mask=ground_mask,
        cluster=cluster,
        cluster_velocity_m_per_s=velocity.astype(np.float32),
        confirmed=confirmed,
    )


def _reattached(
    prepared: Prepared, moves: Mask, confirmed: Mask, ground: Mask
) -> tuple[Mask, Mask]:
    """Ground points that touch something dynamic, and those that touch confirmed; (M,) each."""
    touching = np.zeros(len(ground), np.bool_)
    to_confirmed = np.zeros(len(ground), np.bool_)
    moving = np.flatnonzero(moves)
    asked = np.flatnonzero(ground)
    if len(moving) == 0 or len(asked) == 0:
        return touching, to_confirmed
    grid = build_grid(prepared.voxels.centroids_m[moving], prepared.odom_from_beams[:3, 3])
    places = transform(prepared.odom_from_beams, prepared.points_m[asked])
    nearest = nearest_indices(grid, places, REATTACH_M)
    found = nearest >= 0
    touching[asked[found]] = True
    to_confirmed[asked[found]] = confirmed[moving[grid.order[nearest[found]]]]
    return touching, to_confirmed
