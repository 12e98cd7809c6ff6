"""Camera filter: the points that the paper compares, near, off the ground, in the camera's view."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from schemas.camera import CameraCalibration
from workers.lidar.fidelity import Form
from workers.paper.ground_rule import NOT_GROUND

BOX_M: Final = 35.0
"""Largest distance aside and ahead of the camera in the published code, metres."""

REACH_M: Final = 25.0
"""Largest range of points that the paper compares, metres."""

_FLOW_SIGNS: Final = np.array([-1, -1, 1], np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class FilteredPoints:
    """Points that remain of a cloud after each step, as rising indices.

    Attributes:
        in_view: Points in the image.
        in_range: Those of `in_view` that are near.
        kept: Those of `in_range` that are off the ground; these are compared.
    """

    in_view: NDArray[np.int64]
    in_range: NDArray[np.int64]
    kept: NDArray[np.int64]


def camera_filter(
    points_m: Points,
    ground: NDArray[np.int8],
    calibration: CameraCalibration,
    *,
    form: Form = Form.CORRECTED,
) -> FilteredPoints:
    """Keep the points that are visible to the camera, near it, and off the ground.

    The corrected form differs from the published code in this:

    - points must lie ahead of the camera (published: ahead of the lidar, so that one next to the
      camera may be mirrored into the image);
    - near is horizontally nearer than 25 m, as the paper says (published: less than 35 m aside and
      ahead in the camera's space, and after the flow less than 25 m ahead of the lidar, however far
      aside: `is_ahead_within`);
    - the rotation between camera and rectified image counts.

    Args:
        points_m: (N, 3) lidar's sensor space, metres.
        ground: (N,) result of `ground_labels`; the ground and points outside of its map are
            removed.
        calibration: The camera.
        form: Corrected or published form.
    """
    camera_m = _in_camera(points_m, calibration)
    paper = form is Form.PAPER
    rectified_m = camera_m
    if calibration.rectified_from_camera is not None and not paper:
        rotation = np.array(calibration.rectified_from_camera)
        rectified_m = camera_m @ rotation[:3, :3].T + rotation[:3, 3]
    projection = calibration.projection
    projected = rectified_m @ projection[:, :3].T + projection[:, 3]
    ahead = points_m[:, 0] > 0 if paper else rectified_m[:, 2] > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        pixel = projected[:, :2] / projected[:, 2:]
        inside = ((pixel >= 0) & (pixel < (calibration.width, calibration.height))).all(axis=1)
    in_view = np.flatnonzero(inside & ahead)
    if paper:
        near = (np.abs(camera_m[in_view][:, [0, 2]]) < BOX_M).all(axis=1)
    else:
        near = np.hypot(points_m[in_view, 0], points_m[in_view, 1]) < REACH_M
    in_range = in_view[near]
    return FilteredPoints(in_view, in_range, in_range[ground[in_range] == NOT_GROUND])


def is_ahead_within(points_m: Points, *, reach_m: float = REACH_M) -> Mask:
    """Test which points the published code compares after the flow: less than 25 m ahead."""
    return points_m[:, 0] < reach_m


def to_flow_space(points_m: Points, calibration: CameraCalibration) -> Points:
    """Transform points to the training space of FlowStep3D: x left, y up, z ahead.

    Args:
        points_m: (N, 3) lidar's sensor space, metres.
        calibration: The camera; the flow's space is the camera's with x and y negated.
    """
    return (_in_camera(points_m, calibration) * _FLOW_SIGNS).astype(np.float32)


def from_flow_space(
    flow_points_m: NDArray[np.floating], calibration: CameraCalibration
) -> NDArray[np.float64]:
    """Transform points of the flow's space back to the lidar's, in double precision."""
    back = np.linalg.inv(calibration.extrinsics)  # printed to 13 digits: no exact rotation
    in_camera = flow_points_m.astype(np.float64) * _FLOW_SIGNS
    in_lidar: NDArray[np.float64] = in_camera @ back[:3, :3].T + back[:3, 3]
    return in_lidar


def _in_camera(points_m: Points, calibration: CameraCalibration) -> NDArray[np.float64]:
    camera = calibration.extrinsics
    return points_m.astype(np.float64) @ camera[:3, :3].T + camera[:3, 3]
