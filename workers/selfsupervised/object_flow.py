"""The motion of the objects themselves: scene flow without the part that ego-motion explains."""

from schemas.arrays import Flow, Points, Transform
from workers.geometry.se3 import transform


def object_flow(scene_flow: Flow, points_m: Points, other_from_this: Transform) -> Flow:
    """Remove ego-motion from scene flow, leaving the motion of the objects themselves.

    A point of the static world seems to move because the sensor does; where it would land is known
    from odometry alone. What the flow saw beyond that is object motion.

    Args:
        scene_flow: (N, 3) displacement from this frame to the other, metres, both ends in the
            sensor space of their own frame.
        points_m: (N, 3) the points the flow starts from, this frame's sensor space, metres.
        other_from_this: (4, 4) ego-motion: this frame's sensor space to the other's.

    Returns:
        (N, 3) displacement in metres, axes of the other frame's sensor space; zero for a static
        point and perfect inputs.
    """
    ego_flow = transform(other_from_this, points_m) - points_m
    return scene_flow - ego_flow
