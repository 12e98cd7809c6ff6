"""Counts what one stream got right in one frame."""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import DBSCAN

from schemas.arrays import Mask, MotionLabels, Points
from schemas.labels import MotionLabel
from workers.evaluation.table import RANGES_M, RangeCounts, StreamCounts
from workers.evaluation.truth import TRUTH_DYNAMIC, TRUTH_STATIC, TRUTH_UNKNOWN, FrameTruth

MIN_OBJECT_POINTS: Final = 20
"""Moving objects with fewer points in range are not asked for."""

CLUSTER_EPS_M: Final = 1.0
CLUSTER_MIN_POINTS: Final = 10
FALSE_CLUSTER_POINTS: Final = 25
MAX_TRUE_SHARE: Final = 0.3
"""A cluster is false when a smaller share of it is dynamic, or of unknown truth."""


def count_frame(labels: MotionLabels, truth: FrameTruth, points_m: Points) -> StreamCounts:
    """Count a frame's labels against its truth, under each range.

    Points of unknown truth are not judged; a predicted UNKNOWN counts as not dynamic.

    Args:
        labels: (N,) `MotionLabel` of the stream.
        truth: Of the same points.
        points_m: (N, 3) sensor space; the horizontal range is taken from it.
    """
    range_m = np.hypot(points_m[:, 0], points_m[:, 1])
    called = labels == MotionLabel.DYNAMIC
    counts = StreamCounts(has_tracks=truth.track is not None)
    for limit in RANGES_M:
        near = range_m < limit
        dynamic, static = (near & (truth.motion == kind) for kind in (TRUTH_DYNAMIC, TRUTH_STATIC))
        found, moving = _objects(called, dynamic, truth.track)
        counts.by_range[limit] = RangeCounts(
            hits=int((dynamic & called).sum()),
            false_alarms=int((static & called).sum()),
            misses=int((dynamic & ~called).sum()),
            unknown=int(((dynamic | static) & (labels == MotionLabel.UNKNOWN)).sum()),
            judged=int((dynamic | static).sum()),
            objects=moving,
            objects_found=found,
        )
    near = called & (range_m < RANGES_M[-1])
    counts.false_clusters = _false_clusters(points_m[near], truth.motion[near])
    return counts


def _objects(called: Mask, dynamic: Mask, track: NDArray[np.int16] | None) -> tuple[int, int]:
    """Count moving objects found and all of them; an object is in range where its points are."""
    if track is None or not dynamic.any():
        return 0, 0
    ids, which = np.unique(track[dynamic], return_inverse=True)
    points = np.bincount(which)
    hit = np.bincount(which, weights=called[dynamic])
    asked = (points >= MIN_OBJECT_POINTS) & (ids >= 0)
    return int((asked & (hit > points / 2)).sum()), int(asked.sum())


def _false_clusters(points_m: Points, motion: NDArray[np.uint8]) -> int:
    if len(points_m) < FALSE_CLUSTER_POINTS:
        return 0
    cluster = DBSCAN(eps=CLUSTER_EPS_M, min_samples=CLUSTER_MIN_POINTS).fit_predict(points_m)
    clustered = cluster >= 0
    points = np.bincount(cluster[clustered])
    true_or_unknown = (motion == TRUTH_DYNAMIC) | (motion == TRUTH_UNKNOWN)
    true = np.bincount(cluster[clustered], weights=true_or_unknown[clustered])
    return int(((points >= FALSE_CLUSTER_POINTS) & (true < MAX_TRUE_SHARE * points)).sum())
