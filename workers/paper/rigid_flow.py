"""Rigid flow: registers each cluster to the other frame by translation."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Flow, Points, Transform
from workers.points.clusters import connected
from workers.points.compiled import compiled
from workers.points.se3 import transform
from workers.selfsupervised.registration import MAX_EXTENT_M, MIN_POINTS
from workers.selfsupervised.translation_search import Reference, build_reference, energy_of, search

REACH_M: Final = 0.5
"""Distance between points of one cluster, metres, as in the default stream."""

MAX_SHIFT_M: Final = 4.5
"""Largest translation, metres: 80 km/h, the limit of the two-stage rule, for 0.2 s."""

_MIN_VOXELS: Final = 3
_SAMPLES: Final = 150
_MIN_GAIN_M: Final = 0.01


def rigid_flow(points_m: Points, other_points_m: Points, other_from_this: Transform) -> Flow:
    """Register every cluster of one frame to the other frame, by translation.

    This is the registration of the default stream on one frame interval, without its checks: no
    second frame, and no confirmation by free space. Within a cluster, all flow is equal except for
    ego-motion, so the two-stage rule finds no spread in it.

    Args:
        points_m: (N, 3) points off the ground, sensor space of their frame.
        other_points_m: (M, 3) those of the other frame, in its own sensor space.
        other_from_this: (4, 4) ego-motion between the two.

    Returns:
        (N, 3) displacement to the other frame, metres; ego-motion alone where a point is in no
        cluster, or a translation improves its fit too little.
    """
    expected = transform(other_from_this, points_m)
    clusters = connected(expected, reach_m=REACH_M, min_points=_MIN_VOXELS)
    shift_m = np.zeros((len(points_m), 3), np.float32)
    if len(clusters) and len(other_points_m):
        reference = build_reference(other_points_m, np.zeros(3), 0.0)
        inside = clusters.of_point >= 0
        of_cluster = _shifts(expected, clusters.members, clusters.start, reference)
        shift_m[inside] = of_cluster[clusters.of_point[inside]]
    flow: Flow = expected + shift_m - points_m
    return flow


@compiled
def _shifts(
    points: Points,
    members: NDArray[np.int32],
    start: NDArray[np.int32],
    reference: Reference,
) -> NDArray[np.float32]:
    """Return the best translation of each cluster; zero for tiny ones, and ones beyond a lorry."""
    shifts = np.zeros((len(start) - 1, 3), np.float32)
    best = np.empty(4, np.float64)
    origin = np.zeros(3, np.float64)
    for k in range(len(start) - 1):
        inside = members[start[k] : start[k + 1]]
        low, high = points[inside[0]].copy(), points[inside[0]].copy()
        for i in inside:
            for axis in range(2):
                low[axis] = min(low[axis], points[i, axis])
                high[axis] = max(high[axis], points[i, axis])
        if len(inside) < MIN_POINTS or max(high[0] - low[0], high[1] - low[1]) > MAX_EXTENT_M:
            continue
        sample = points[inside[:: (len(inside) + _SAMPLES - 1) // _SAMPLES]]
        nobody = np.full(len(sample), -1, np.int32)
        still = energy_of(reference.grid, sample, 0.0, 0.0, 0.0, nobody)
        best[:3], best[3] = 0.0, still
        search(reference, sample, origin, MAX_SHIFT_M, 3, best)
        if still - best[3] >= _MIN_GAIN_M:
            for axis in range(3):
                shifts[k, axis] = best[axis]
    return shifts
