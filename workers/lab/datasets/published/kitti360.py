"""KITTI-360: drives with velodyne scans, poses and images; its labels are of maps, not of scans.

Source: cvlibs.net/datasets/kitti-360, documentation.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from schemas.arrays import Transform
from workers.lab.datasets.conversion.source import (
    CameraModel,
    DatasetUnusableError,
    Picture,
    SourceFrame,
    SourceLog,
)
from workers.lab.datasets.published.files import (
    key_values,
    matrix_of,
    need_frames_of,
    numbered,
    pose_rows,
    read_floats,
    rows_of,
    square,
    stamps_of,
)
from workers.lab.datasets.published.options import ReadOptions
from workers.lab.datasets.published.semantickitti import SPACE, TOPIC, rectified

VEHICLE: Final = "annieway-360"
_CAMERA: Final = "front"
_NAME: Final = "2013_05_28_drive_"


def find_logs(source: Path, options: ReadOptions) -> list[SourceLog]:
    """Find the drives below the root, which has `data_3d_raw` and `calibration`."""
    root = source.parent if source.name == "data_3d_raw" else source
    found = sorted(path.parent for path in root.glob("data_3d_raw/*/velodyne_points"))
    return [_log(root, each.name, options) for each in found]


def _log(root: Path, drive: str, options: ReadOptions) -> SourceLog:
    folder = root / "data_3d_raw" / drive / "velodyne_points"
    scans = numbered(folder / "data", ".bin", what="scans")
    stamps = stamps_of(folder / "timestamps.txt")
    if len(stamps) <= max(scans):
        raise DatasetUnusableError(
            f"timestamps.txt has {len(stamps)} times, scan {max(scans)} has none ({folder})"
        )
    notes = ["no labels: those of KITTI-360 are of accumulated clouds, not of scans"]
    mounting = _mounting(root / "calibration")
    path = root / "data_poses" / drive / "poses.txt"
    poses: dict[int, Transform] = {}
    if path.is_file() and mounting is not None:
        for row in pose_rows(path, 13):
            poses[int(row[0])] = square(row[1:].reshape(3, 4)) @ mounting
        lacking = sum(number not in poses for number in scans)
        if lacking:
            notes.append(f"no pose: {lacking} of {len(scans)} scans, which KITTI-360 leaves out")
    else:
        notes.append("no poses: data_poses or calibration is missing")
    cameras, images = _camera(root, drive, scans, options)
    return SourceLog(
        name=f"kitti360-{drive.removeprefix(_NAME).removesuffix('_sync')}",
        vehicle=VEHICLE,
        date=np.datetime64(stamps[min(scans)], "ns").astype("datetime64[D]").item().isoformat(),
        topic=TOPIC,
        space=SPACE,
        length=len(scans),
        frames=partial(_frames, scans, stamps, poses, images),
        cameras=cameras,
        base_from_lidar=mounting,
        notes=tuple(notes),
    )


def _mounting(folder: Path) -> Transform | None:
    """Return the pose of the lidar in the space of the poses, by both calibrations of camera 0."""
    to_pose, to_lidar = folder / "calib_cam_to_pose.txt", folder / "calib_cam_to_velo.txt"
    if not to_pose.is_file() or not to_lidar.is_file():
        return None
    pose_from_camera = square(matrix_of(key_values(to_pose), "image_00", (3, 4), to_pose))
    lidar_from_camera = square(pose_rows(to_lidar, 12)[0].reshape(3, 4))
    mounting: Transform = pose_from_camera @ np.linalg.inv(lidar_from_camera)
    return mounting


def _camera(
    root: Path, drive: str, scans: Mapping[int, Path], options: ReadOptions
) -> tuple[tuple[CameraModel, ...], dict[int, Picture]]:
    folder = root / "data_2d_raw" / drive / "image_00"
    if not options.with_cameras or not (folder / "data_rect").is_dir():
        return (), {}
    images = numbered(folder / "data_rect", ".png", what="images", gaps=True)
    need_frames_of(list(images), scans, folder=folder)
    stamps = stamps_of(folder / "timestamps.txt")
    if len(stamps) <= max(images):
        raise DatasetUnusableError(f"image {max(images)} has no time ({folder})")
    path = root / "calibration" / "perspective.txt"
    values = key_values(path)
    projection = matrix_of(values, "P_rect_00", (3, 4), path)
    turned = square(matrix_of(values, "R_rect_00", (3, 3), path))
    to_lidar = root / "calibration" / "calib_cam_to_velo.txt"
    lidar_from_camera = square(pose_rows(to_lidar, 12)[0].reshape(3, 4))
    camera_from_lidar = turned @ np.linalg.inv(lidar_from_camera)
    model = rectified(_CAMERA, projection, camera_from_lidar, next(iter(images.values())))
    pictures = {number: Picture(_CAMERA, stamps[number], image) for number, image in images.items()}
    return (model,), pictures


def _frames(
    scans: Mapping[int, Path],
    stamps: Sequence[int],
    poses: Mapping[int, Transform],
    images: Mapping[int, Picture],
) -> Iterator[SourceFrame]:
    for number, path in scans.items():
        points = read_floats(path, 4)
        yield SourceFrame(
            stamp_ns=stamps[number],
            rows=rows_of(points, points[:, 3]),
            world_from_sensor=poses.get(number),
            pictures=[images[number]] if number in images else (),
        )
