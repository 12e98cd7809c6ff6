"""Per-frame counts of motion labels against truth: hits, misses, false alarms, objects."""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import DBSCAN

from schemas.arrays import Mask, Points, Transform
from schemas.labels import FrameLabels, MotionLabel
from workers.lab.evaluation.motion.counts import RANGES_M, RangeCounts, StreamCounts
from workers.lab.evaluation.truth.objects import TrueObject
from workers.lab.evaluation.truth.truth import (
    TRUTH_DYNAMIC,
    TRUTH_STATIC,
    TRUTH_UNKNOWN,
    FrameTruth,
)

MIN_OBJECT_POINTS: Final = 20
"""Points in range that a moving object needs to be counted."""

CLUSTER_EPS_M: Final = 1.0
CLUSTER_MIN_POINTS: Final = 10
FALSE_CLUSTER_POINTS: Final = 25
MAX_TRUE_SHARE: Final = 0.3
"""True share below which a dynamic cluster is false; points of unknown truth count as true."""


def count_frame(
    predicted: FrameLabels,
    truth: FrameTruth,
    points_m: Points,
    *,
    log_id: str = "",
    odom_from_sensor: Transform | None = None,
) -> StreamCounts:
    """Count a frame's labels against its truth, under each range.

    Points of unknown truth are not counted; a predicted UNKNOWN counts as not dynamic.

    Args:
        predicted: Labels of the stream for N points.
        truth: Truth of the same points.
        points_m: (N, 3) sensor space; the horizontal range is computed from it.
        log_id: Log of the frame; tracks of different logs are different objects.
        odom_from_sensor: (4, 4) pose given to the stream; without it, velocities are not evaluated.
    """
    range_m = np.hypot(points_m[:, 0], points_m[:, 1])
    called = predicted.labels == MotionLabel.DYNAMIC
    unknown = predicted.labels == MotionLabel.UNKNOWN
    counts = StreamCounts()
    for limit in RANGES_M:
        near = range_m < limit
        counts.by_range[limit] = _count_points(called, unknown, truth, near)
        if predicted.confirmed is not None:
            counts.confirmed[limit] = _count_points(predicted.confirmed, unknown, truth, near)
    near = range_m < RANGES_M[-1]
    counts.false_clusters = _false_clusters(called & near, points_m, truth.motion)
    if predicted.confirmed is not None:
        counts.confirms = True
        confirmed = predicted.confirmed & near
        counts.confirmed_false_clusters = _false_clusters(confirmed, points_m, truth.motion)
    _count_objects(counts, called, truth, near, log_id)
    if odom_from_sensor is not None:
        _count_velocities(counts, predicted, called & near, truth, odom_from_sensor)
    return counts


def _count_points(called: Mask, unknown: Mask, truth: FrameTruth, near: Mask) -> RangeCounts:
    dynamic, static = (near & (truth.motion == kind) for kind in (TRUTH_DYNAMIC, TRUTH_STATIC))
    _, points, hits = _objects(called, dynamic, truth.track)
    return RangeCounts(
        hits=int((dynamic & called).sum()),
        false_alarms=int((static & called).sum()),
        misses=int((dynamic & ~called).sum()),
        unknown=int(((dynamic | static) & unknown).sum()),
        judged=int((dynamic | static).sum()),
        objects=len(points),
        objects_found=int((hits > points / 2).sum()),
    )


def _objects(
    called: Mask, dynamic: Mask, track: NDArray[np.int16] | None
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Find moving objects with enough points: id, points, and points labelled dynamic; (K,) each.

    An object is in range where its points are.
    """
    if track is None or not dynamic.any():
        nothing = np.zeros(0, np.int64)
        return nothing, nothing, nothing
    ids, which = np.unique(track[dynamic], return_inverse=True)
    points = np.bincount(which)
    hits = np.bincount(which[called[dynamic]], minlength=len(ids))
    asked = (points >= MIN_OBJECT_POINTS) & (ids >= 0)
    return ids[asked].astype(np.int64), points[asked], hits[asked]


def _count_objects(
    counts: StreamCounts, called: Mask, truth: FrameTruth, near: Mask, log_id: str
) -> None:
    """Count objects under the largest range by class, speed, size and points."""
    dynamic = near & (truth.motion == TRUTH_DYNAMIC)
    found = zip(*(each.tolist() for each in _objects(called, dynamic, truth.track)), strict=True)
    for track, points, hits in found:
        for dimension, kind in truth.objects.get(track, TrueObject()).kinds(points):
            of_kind = counts.objects_of(dimension, kind)
            of_kind.observed += 1
            of_kind.tracks.add((log_id, track))
            if 2 * hits > points:
                of_kind.found += 1
                of_kind.tracks_found.add((log_id, track))


def _count_velocities(
    counts: StreamCounts,
    predicted: FrameLabels,
    called: Mask,
    truth: FrameTruth,
    odom_from_sensor: Transform,
) -> None:
    """Compare velocities in sensor space, which truth and stream have in common."""
    if predicted.cluster is None or predicted.cluster_velocity_m_per_s is None:
        return
    if truth.world_from_sensor is None or truth.track is None:
        return
    judged = called & (truth.motion == TRUTH_DYNAMIC) & (predicted.cluster >= 0)
    of_cluster = predicted.cluster_velocity_m_per_s.astype(np.float64) @ odom_from_sensor[:3, :3]
    for track in np.unique(truth.track[judged]).tolist():
        true = truth.objects.get(track, TrueObject()).velocity_m_per_s
        if true is None:
            continue
        points = judged & (truth.track == track)
        error = of_cluster[predicted.cluster[points]] - true @ truth.world_from_sensor
        counts.add_velocity_errors(np.hypot(error[:, 0], error[:, 1]))


def _false_clusters(called: Mask, points_m: Points, motion: NDArray[np.uint8]) -> int:
    if called.sum() < FALSE_CLUSTER_POINTS:
        return 0
    cluster = DBSCAN(eps=CLUSTER_EPS_M, min_samples=CLUSTER_MIN_POINTS).fit_predict(
        points_m[called]
    )
    clustered = cluster >= 0
    points = np.bincount(cluster[clustered])
    true_or_unknown = np.isin(motion[called], (TRUTH_DYNAMIC, TRUTH_UNKNOWN))
    true = np.bincount(cluster[clustered], weights=true_or_unknown[clustered])
    return int(((points >= FALSE_CLUSTER_POINTS) & (true < MAX_TRUE_SHARE * points)).sum())
