"""Deskewing: twists of the sensor, and clouds compensated to the middle of their sweep."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from schemas.arrays import Points, Transform
from schemas.frame import LidarFrame
from workers.points.compiled import compiled
from workers.points.point_kernels import first_and_last
from workers.points.step_names import step

Twist = NDArray[np.float64]
"""(6,) rotation vector in radians, then translation in metres; per second when divided by time."""


def twist(earlier_from_later: Transform) -> Twist:
    """Split a motion into its rotation vector and its translation."""
    rotation = Rotation.from_matrix(earlier_from_later[:3, :3]).as_rotvec()
    return np.concatenate([rotation, earlier_from_later[:3, 3]])


def motion(of: Twist) -> Transform:
    """Compose a motion from its rotation vector and its translation."""
    earlier_from_later: Transform = np.eye(4)
    earlier_from_later[:3, :3] = Rotation.from_rotvec(of[:3]).as_matrix()
    earlier_from_later[:3, 3] = of[3:]
    return earlier_from_later


def time_from_middle_s(frame: LidarFrame) -> NDArray[np.float32] | None:
    """Return the measurement time of each point, relative to the middle of its sweep.

    Returns:
        (N,) seconds; None where the log has no time per point, or the same for all of them.
    """
    if not frame.has_point_time:
        return None
    first, last = first_and_last(frame.offset_ns, frame.valid_mask)
    if first >= last:
        return None
    return _seconds_since(frame.offset_ns, (first + last) / 2)


@step("deskew")
def deskew(points_m: Points, time_from_middle_s: NDArray[np.float32], velocity: Twist) -> Points:
    """Compensate the motion within a sweep, to the sensor's pose in the middle of it.

    Args:
        points_m: (N, 3) as measured, sensor space of each point's own instant, metres.
        time_from_middle_s: (N,) that instant.
        velocity: Twist of the sensor per second, in its own space.

    Returns:
        (N, 3) float32, sensor space of the middle of the sweep.
    """
    return _deskew(points_m, time_from_middle_s, velocity.astype(np.float32))


@compiled
def _seconds_since(offset_ns: NDArray[np.int32], middle_ns: float) -> NDArray[np.float32]:
    time = np.empty(len(offset_ns), np.float32)
    for i in range(len(offset_ns)):
        time[i] = (offset_ns[i] - middle_ns) * 1e-9
    return time


@compiled
def _deskew(points: Points, time: NDArray[np.float32], velocity: NDArray[np.float32]) -> Points:
    """Compensate to second order in the angle: 0.05 rad within a sweep leave 2 mm at 80 m."""
    out = np.empty((len(points), 3), np.float32)
    wx, wy, wz = velocity[0], velocity[1], velocity[2]
    for i in range(len(points)):
        x, y, z, t = points[i, 0], points[i, 1], points[i, 2], time[i]
        cx, cy, cz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        half = np.float32(0.5) * t * t
        out[i, 0] = x + t * (cx + velocity[3]) + half * (wy * cz - wz * cy)
        out[i, 1] = y + t * (cy + velocity[4]) + half * (wz * cx - wx * cz)
        out[i, 2] = z + t * (cz + velocity[5]) + half * (wx * cy - wy * cx)
    return out
