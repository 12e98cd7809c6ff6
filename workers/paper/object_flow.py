"""Object flow: scene flow without the part that ego-motion explains."""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Flow, Points, Transform
from schemas.camera import CameraCalibration
from workers.paper.camera_filter import from_flow_space
from workers.points.se3 import transform


def object_flow(scene_flow: Flow, points_m: Points, other_from_this: Transform) -> Flow:
    """Remove ego-motion from scene flow, leaving the motion of the objects themselves.

    A static point seems to move because the sensor does; odometry alone gives that displacement.
    The remaining flow is object motion.

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


def flow_ends(
    flow_points_m: Points, flow_m: Flow, calibration: CameraCalibration, this_from_other: Transform
) -> NDArray[np.float64]:
    """Return the ends of the flow in the sensor space of its start, as in the published chain.

    `object_flow` expresses the same motion in the axes of the other frame, in single precision and
    without a camera.

    Args:
        flow_points_m: (N, 3) points of `to_flow_space`, metres.
        flow_m: (N, 3) displacement to the other frame in that space, ego-motion included.
        calibration: The camera.
        this_from_other: (4, 4) ego-motion: the other frame's sensor space to this one's.

    Returns:
        (N, 3) ends in this frame's sensor space; less the points, the object flow.
    """
    ends_m = from_flow_space(flow_points_m + flow_m, calibration).astype(np.float32)  # as published
    return ends_m @ this_from_other[:3, :3].T + this_from_other[:3, 3]
