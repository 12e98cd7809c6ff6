"""Fields of the ROS 2 messages of a converted log: transforms, odometry, images, calibrations."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from schemas.arrays import NS_PER_S, Transform
from workers.lab.datasets.conversion.source import CameraModel

_UNKNOWN_COVARIANCE: Final = [0.0] * 36


def header_of(stamp_ns: int, space: str) -> dict[str, Any]:
    """Return a `std_msgs/Header`."""
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": space}


def transforms_of(
    stated: list[tuple[str, str, Transform]], *, stamp_ns: int
) -> dict[str, list[dict[str, Any]]]:
    """Return a `tf2_msgs/TFMessage` of parent, child and `parent_from_child`."""
    return {
        "transforms": [
            {
                "header": header_of(stamp_ns, parent),
                "child_frame_id": child,
                "transform": {
                    "translation": _vector(pose[:3, 3]),
                    "rotation": _quaternion(pose),
                },
            }
            for parent, child, pose in stated
        ]
    }


def odometry_of(
    world_from_sensor: Transform,
    *,
    stamp_ns: int,
    space: str,
    since: tuple[int, Transform] | None,
) -> dict[str, Any]:
    """Return a `nav_msgs/Odometry`: a pose of the data set, and the motion since the one before.

    Args:
        world_from_sensor: (4, 4) pose.
        stamp_ns: Its time.
        space: Coordinate system of the sensor.
        since: Time and pose before; None for the first one, whose twist is zero.
    """
    linear, angular = np.zeros(3), np.zeros(3)
    if since is not None and stamp_ns > since[0]:
        seconds = (stamp_ns - since[0]) / NS_PER_S
        moved = np.linalg.inv(since[1]) @ world_from_sensor
        linear = moved[:3, :3].T @ moved[:3, 3] / seconds
        angular = Rotation.from_matrix(moved[:3, :3]).as_rotvec() / seconds
    return {
        "header": header_of(stamp_ns, "map"),
        "child_frame_id": space,
        "pose": {
            "pose": {
                "position": _vector(world_from_sensor[:3, 3]),
                "orientation": _quaternion(world_from_sensor),
            },
            "covariance": _UNKNOWN_COVARIANCE,
        },
        "twist": {
            "twist": {"linear": _vector(linear), "angular": _vector(angular)},
            "covariance": _UNKNOWN_COVARIANCE,
        },
    }


def camera_info_of(camera: CameraModel, *, stamp_ns: int) -> dict[str, Any]:
    """Return a `sensor_msgs/CameraInfo`."""
    projection = np.zeros((3, 4))
    projection[:, :3] = camera.intrinsics
    return {
        "header": header_of(stamp_ns, camera.space),
        "height": camera.height,
        "width": camera.width,
        "distortion_model": camera.distortion_model,
        "d": list(camera.distortion),
        "k": camera.intrinsics.ravel().tolist(),
        "r": np.eye(3).ravel().tolist(),
        "p": projection.ravel().tolist(),
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def image_of(camera: CameraModel, data: bytes, *, stamp_ns: int, form: str) -> dict[str, Any]:
    """Return a `sensor_msgs/CompressedImage` of a file's bytes."""
    return {"header": header_of(stamp_ns, camera.space), "format": form, "data": data}


def _vector(values: NDArray[np.float64]) -> dict[str, float]:
    return dict(zip("xyz", (float(each) for each in values), strict=True))


def _quaternion(pose: Transform) -> dict[str, float]:
    quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return dict(zip("xyzw", (float(each) for each in quaternion), strict=True))
