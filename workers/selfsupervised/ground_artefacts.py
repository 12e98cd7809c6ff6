"""Ground artefacts: flat clusters low over the road, strips of ground and kerb.

They appear and disappear with shadows and are not objects.
"""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform
from workers.points.clusters import Clusters
from workers.points.compiled import compiled
from workers.points.step_names import step

FLAT_M = 0.25
ROAD_M = 0.4
ROAD_PER_M = 0.02
"""Height over the plane under the car below which a cluster may be road, metres, and its growth
per metre of range: a kerb, and a slope of 2 %."""

_LOW, _HIGH = 0.03, 0.97


@step("strips")
def are_ground_artefacts(
    points_m: Points,
    clusters: Clusters,
    candidates: Mask,
    *,
    beams_from_odom: Transform,
    sensor_height_m: float,
) -> Mask:
    """Return the candidate clusters that are flat and as low as the road may be.

    Flat objects above the road are roofs and bonnets, which a single beam may graze.

    Args:
        points_m: (N, 3) voxel centroids, odom space.
        clusters: K sets of them.
        candidates: (K,) candidate clusters.
        beams_from_odom: (4, 4) inverse pose of the frame.
        sensor_height_m: Height of the origin of the beams over the road.

    Returns:
        (K,) bool; False outside the candidates.
    """
    return _are_ground_artefacts(
        points_m, clusters.members, clusters.start, candidates, beams_from_odom[:3], sensor_height_m
    )


@compiled
def _are_ground_artefacts(
    points: Points,
    members: NDArray[np.int32],
    start: NDArray[np.int32],
    candidates: Mask,
    pose: NDArray[np.float64],
    sensor_height: float,
) -> Mask:
    artefact = np.zeros(len(candidates), np.bool_)
    for k in range(len(candidates)):
        inside = members[start[k] : start[k + 1]]
        if not candidates[k] or len(inside) == 0:
            continue
        heights = np.empty(len(inside), np.float64)
        x, y = 0.0, 0.0
        for n in range(len(inside)):
            px, py, pz = points[inside[n], 0], points[inside[n], 1], points[inside[n], 2]
            x += pose[0, 0] * px + pose[0, 1] * py + pose[0, 2] * pz + pose[0, 3]
            y += pose[1, 0] * px + pose[1, 1] * py + pose[1, 2] * pz + pose[1, 3]
            heights[n] = pose[2, 0] * px + pose[2, 1] * py + pose[2, 2] * pz + pose[2, 3]
        heights.sort()
        low, high = _quantile(heights, _LOW), _quantile(heights, _HIGH)
        away = np.sqrt(x * x + y * y) / len(inside)
        artefact[k] = high - low < FLAT_M and high < ROAD_M + ROAD_PER_M * away - sensor_height
    return artefact


@compiled
def _quantile(rising: NDArray[np.float64], share: float) -> float:
    """Interpolate a quantile of sorted values linearly between the two nearest ranks."""
    place = share * (len(rising) - 1)
    below = int(place)
    above = min(below + 1, len(rising) - 1)
    return float(rising[below] + (place - below) * (rising[above] - rising[below]))
