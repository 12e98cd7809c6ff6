"""Labelling: the evidence on clusters and voxels becomes one label and confidence per point."""

from typing import Final

import numpy as np

from schemas.frame import LidarFrame
from schemas.labels import FrameHealth, FrameLabels, MotionLabel
from workers.free_space import Votes
from workers.lidar.beam_table import MIN_RANGE_M
from workers.lidar.preprocessing import MAX_RANGE_M, PreprocessedFrame
from workers.points.point_kernels import within
from workers.points.step_names import step
from workers.selfsupervised.ground_reattachment import SeenThrough, reattach_ground
from workers.selfsupervised.motion import ClusterMotions
from workers.selfsupervised.near_points import continue_movers
from workers.selfsupervised.point_labels import (
    copy_to_points,
    label_ground,
    label_near_points,
    label_voxels,
    unlabelled_points,
)
from workers.selfsupervised.tracker import Tracked

AGREED: Final = 0.95
"""Confidence where registration and free space agree: measured point precision .999 and .965 to
.99."""

ALONE: Final = 0.7
"""Confidence where one of them, or only the earlier frames, supports the label."""

GROUND: Final = 0.9
"""Confidence of static ground; nine in ten points labelled ground are ground."""

_CONFIDENCE: Final = np.array([0.0, ALONE, GROUND, AGREED], np.float16)
"""Confidences in the order of `point_labels`: unsure, alone, ground, agreed."""


def unknown_labels(
    frame: LidarFrame, prepared: PreprocessedFrame | None = None, *, health: FrameHealth
) -> FrameLabels:
    """Label every point UNKNOWN; the ground mask is kept where the ground was found."""
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
    prepared: PreprocessedFrame,
    found: ClusterMotions,
    tracked: Tracked,
    votes: Votes,
    *,
    seen_through: SeenThrough,
) -> FrameLabels:
    """Label every point of a frame.

    DYNAMIC: the frames so far confirm that its cluster moves. STATIC: it is ground, its cluster
    fits its earlier place, or most voting frames saw its place occupied. UNKNOWN: no evidence, or
    a motion that is not confirmed, and every point that is invalid, too near, too far or too high.
    """
    clusters, voxels = found.clusters, prepared.voxels
    of_voxel = clusters.of_point
    in_range = prepared.ground & within(prepared.points_m, MIN_RANGE_M, MAX_RANGE_M)
    touching, touching_confirmed = reattach_ground(
        prepared,
        clusters.member_mask(tracked.dynamic),
        clusters.member_mask(tracked.confirmed),
        in_range,
        seen_through,
    )
    voxel_labels, voxel_sureness = label_voxels(
        of_voxel,
        moves=tracked.dynamic,
        both=found.registered & found.seen_through,
        static=found.still & ~found.dynamic_now,
        doubted=found.unconfirmed | found.dynamic_now,
        occupied_before=votes.occupied > votes.free,
    )
    labelled = unlabelled_points(len(frame))
    valid = prepared.valid_index
    label_ground(labelled, valid, prepared.ground, in_range, touching, touching_confirmed)
    judged = valid[prepared.judged_index]
    copy_to_points(
        labelled, judged, voxels.of_point, voxel_labels, voxel_sureness, of_voxel, tracked.confirmed
    )
    near, of_mover = continue_movers(prepared, clusters, tracked.dynamic)
    label_near_points(labelled, valid[near], of_mover, tracked.confirmed)
    velocity = np.where(tracked.dynamic[:, None], tracked.velocity_m_per_s, 0.0)
    return FrameLabels(
        labels=labelled.labels,
        confidence=_CONFIDENCE[labelled.sureness],
        ground_mask=labelled.ground,
        cluster=labelled.cluster,
        cluster_velocity_m_per_s=velocity.astype(np.float32),
        confirmed=labelled.confirmed,
    )
