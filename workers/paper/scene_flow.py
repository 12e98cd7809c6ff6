"""Scene flow as a function of two clouds, and the simplest one.

Others are `workers.paper.rigid_flow` and `workers.paper.learned_flow`.
"""

from collections.abc import Callable

import numpy as np

from schemas.arrays import Flow, Points, Transform
from workers.points.se3 import transform

SceneFlowSource = Callable[[Points, Points, Transform], Flow]
"""Function from (N, 3) points of this frame, (M, 3) points of the other, each in its own sensor
space, and the ego-motion `other_from_this` as initial estimate. It returns (N, 3) displacement to
the other frame, ego-motion included, metres."""


def nearest_neighbour_flow(
    points_m: Points, other_points_m: Points, other_from_this: Transform
) -> Flow:
    """Return the flow to the nearest point of the other frame, after ego-motion compensation.

    This is the simplest source. It matches overlapping surfaces: a car that moves a metre still has
    neighbours at zero distance on itself, so most of its motion is missed.
    """
    from scipy.spatial import cKDTree

    if len(points_m) == 0 or len(other_points_m) == 0:
        return np.zeros_like(points_m)
    expected = transform(other_from_this, points_m)
    _, nearest = cKDTree(other_points_m).query(expected)
    flow: Flow = other_points_m[nearest] - points_m
    return flow
