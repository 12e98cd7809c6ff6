"""Projection of lidar points into the camera picture, for each data set of CODA."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from schemas.errors import PermanentError
from workers.lab.lidarcoda.annotations import Dataset, Image
from workers.lab.lidarcoda.once_camera import once_pixels

Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Projected:
    """Points in front of the camera.

    Attributes:
        index: (N,) rows of the cloud.
        pixels: (N, 2) column and row in the picture, pixels.
        depth_m: (N,) distance along the camera's axis, metres.
        restored_m: (N, 3) points computed back from pixel and depth, lidar space, metres. The
            published steps use them in place of the points.
    """

    index: NDArray[np.intp]
    pixels: Matrix
    depth_m: Matrix
    restored_m: Matrix


Camera = Callable[[Matrix], Projected]
"""Takes (N, 3) points in lidar space, metres."""


class NuscenesCalibration(BaseModel):
    """Poses and intrinsics of one nuScenes sample: `a_from_b` is a (4, 4) matrix."""

    model_config = ConfigDict(extra="ignore")
    ego_from_lidar: list[list[float]]
    global_from_ego_at_lidar: list[list[float]]
    global_from_ego_at_camera: list[list[float]]
    ego_from_camera: list[list[float]]
    camera_intrinsic: list[list[float]]


class OnceCalibration(BaseModel):
    """Calibration of ONCE's camera `cam03`, with the names of that data set."""

    model_config = ConfigDict(extra="ignore")
    cam_to_velo: list[list[float]]
    cam_intrinsic: list[list[float]]
    distortion: list[float]


KITTI_KEYS: Final = ("P2", "R0_rect", "Tr_velo_to_cam")


def read_camera(folder: Path, image: Image, *, published: bool = False) -> Camera:
    """Read the camera of an image from `calib/NNNN`: .txt for KITTI, .json for the others.

    Args:
        folder: Folder in CODA's form.
        image: The image.
        published: True for the published projection of ONCE, which leaves out the distortion.

    Raises:
        PermanentError: If the file is missing, or is no calibration of the image's data set.
    """
    ending = "txt" if image.dataset is Dataset.KITTI else "json"
    path = folder / "calib" / f"{image.stem}.{ending}"
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise PermanentError(f"image {image.id} has no readable calibration: {error}") from None
    try:
        if image.dataset is Dataset.KITTI:
            return linear_camera(_kitti_matrix(text), ahead_of_lidar=True)
        if image.dataset is Dataset.NUSCENES:
            return linear_camera(_nuscenes_matrix(NuscenesCalibration.model_validate_json(text)))
        return _once_camera(OnceCalibration.model_validate_json(text), published=published)
    except (ValueError, ValidationError, np.linalg.LinAlgError) as error:
        first = str(error).splitlines()[0]
        raise PermanentError(f"no calibration of {image.dataset}: {first} ({path})") from None


def linear_camera(image_from_lidar: Matrix, *, ahead_of_lidar: bool = False) -> Camera:
    """Make a camera of one (4, 4) matrix, whose third row gives the depth.

    Args:
        image_from_lidar: (4, 4) maps lidar space to (u·depth, v·depth, depth, 1).
        ahead_of_lidar: True to leave out points behind the lidar (x < 0), as published for KITTI.
    """
    lidar_from_image = np.linalg.inv(image_from_lidar)

    def project(points_m: Matrix) -> Projected:
        index = np.flatnonzero(points_m[:, 0] >= 0) if ahead_of_lidar else np.arange(len(points_m))
        homogeneous = _homogeneous(points_m[index]) @ image_from_lidar.T
        ahead = homogeneous[:, 2] > 0
        homogeneous, index = homogeneous[ahead], index[ahead]
        depth = homogeneous[:, 2]
        pixels = homogeneous[:, :2] / depth[:, None]
        back = np.column_stack((pixels * depth[:, None], depth))
        restored = (lidar_from_image @ _homogeneous(back).T).T[:, :3]
        return Projected(index, pixels, depth, restored)

    return project


def _once_camera(calibration: OnceCalibration, *, published: bool) -> Camera:
    lidar_from_camera = _matrix(calibration.cam_to_velo, (4, 4))
    camera_from_lidar = np.linalg.inv(lidar_from_camera)
    intrinsic = _matrix(calibration.cam_intrinsic, (3, 3))
    distortion = np.asarray(calibration.distortion, np.float64)

    def project(points_m: Matrix) -> Projected:
        in_camera = (_homogeneous(points_m) @ camera_from_lidar.T)[:, :3]
        index = np.flatnonzero(in_camera[:, 2] > 0)
        in_camera = in_camera[index]
        pixels = once_pixels(in_camera, intrinsic, distortion, published=published)
        restored = (_homogeneous(in_camera) @ lidar_from_camera.T)[:, :3]
        return Projected(index, pixels, in_camera[:, 2], restored)

    return project


def _kitti_matrix(text: str) -> Matrix:
    rows: dict[str, list[float]] = {}
    for line in text.splitlines():
        name, _, values = line.partition(":")
        if name in KITTI_KEYS:
            rows[name] = [float(value) for value in values.split()]
    missing = [name for name in KITTI_KEYS if name not in rows]
    if missing:
        raise ValueError(f"it lacks {', '.join(missing)}")
    projection, rotation, camera = (np.eye(4) for _ in KITTI_KEYS)
    projection[:3] = np.reshape(rows["P2"], (3, 4))
    rotation[:3, :3] = np.reshape(rows["R0_rect"], (3, 3))
    camera[:3] = np.reshape(rows["Tr_velo_to_cam"], (3, 4))
    matrix: Matrix = projection @ rotation @ camera
    return matrix


def _nuscenes_matrix(found: NuscenesCalibration) -> Matrix:
    ego_from_camera = _matrix(found.ego_from_camera, (4, 4))
    global_from_camera = _matrix(found.global_from_ego_at_camera, (4, 4)) @ ego_from_camera
    global_from_lidar = _matrix(found.global_from_ego_at_lidar, (4, 4)) @ _matrix(
        found.ego_from_lidar, (4, 4)
    )
    intrinsic = np.eye(4)
    intrinsic[:3, :3] = _matrix(found.camera_intrinsic, (3, 3))
    matrix: Matrix = intrinsic @ np.linalg.inv(global_from_camera) @ global_from_lidar
    return matrix


def _matrix(rows: Any, shape: tuple[int, int]) -> Matrix:
    matrix = np.asarray(rows, np.float64)
    if matrix.shape != shape or not np.isfinite(matrix).all():
        raise ValueError(f"a matrix must be {shape} and finite, got {matrix.shape}")
    return matrix


def _homogeneous(points_m: Matrix) -> Matrix:
    return np.column_stack((points_m, np.ones(len(points_m))))
