"""KITTI raw: drives of a day with velodyne scans, oxts poses, images and tracklets.

Source: cvlibs.net/datasets/kitti, raw data development kit.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Transform
from workers.lab.datasets.conversion.boxes import SourceBox, TrackNumbers, truth_of_boxes
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
    read_floats,
    rows_of,
    square,
    stamps_of,
)
from workers.lab.datasets.published.options import ReadOptions
from workers.lab.datasets.published.oxts import read_oxts
from workers.lab.datasets.published.semantickitti import SPACE, TOPIC, VEHICLE, rectified
from workers.lab.datasets.published.tracklets import CLASSES, read_tracklets
from workers.points.se3 import inverse

_LABEL_OF: Final = np.array([0, *(row.label for row in CLASSES)], np.uint32)
_CAMERA: Final = "front"

VIEW_RAD: Final = np.radians(40.0)
"""Half of the camera's horizontal view, radians: tracklets name what is in the images."""


def find_logs(source: Path, options: ReadOptions) -> list[SourceLog]:
    """Find the drives of a folder: the root, a day, or one drive."""
    if (source / "velodyne_points" / "data").is_dir():
        return [_log(source, options)]
    found = sorted(
        path.parent.parent
        for pattern in ("*/velodyne_points/data", "*/*/velodyne_points/data")
        for path in source.glob(pattern)
    )
    return [_log(each, options) for each in found]


def _log(folder: Path, options: ReadOptions) -> SourceLog:
    scans = numbered(folder / "velodyne_points" / "data", ".bin", what="scans")
    stamps = stamps_of(folder / "velodyne_points" / "timestamps.txt")
    if len(stamps) <= max(scans):
        raise DatasetUnusableError(
            f"timestamps.txt has {len(stamps)} times, scan {max(scans)} has none "
            f"({folder / 'velodyne_points'})"
        )
    notes = ["stamp: the middle of a scan, when the lidar looks ahead"]
    day = folder.parent
    path = day / "calib_imu_to_velo.txt"
    poses, imu_from_lidar = None, None
    if (folder / "oxts" / "data").is_dir() and path.is_file():
        lidar_from_imu = _rigid(path)
        imu_from_lidar = inverse(lidar_from_imu)
        of_imu = read_oxts(folder / "oxts" / "data", scans)
        poses = {number: pose @ imu_from_lidar for number, pose in of_imu.items()}
    else:
        notes.append("no poses: oxts or calib_imu_to_velo.txt is missing")
    boxes = None
    tracklets = folder / "tracklet_labels.xml"
    if tracklets.is_file() and poses is not None:
        boxes = read_tracklets(tracklets, scans, poses, stamps)
        notes.append("motion: of tracklets; what is beyond the camera's view is not judged")
    else:
        notes.append("no tracklet_labels.xml, or no poses: this truth has no motion")
    cameras, images = _camera(folder, scans, options)
    return SourceLog(
        name=f"kitti-raw-{folder.name.removesuffix('_sync').removesuffix('_extract')}",
        vehicle=VEHICLE,
        date=np.datetime64(stamps[min(scans)], "ns").astype("datetime64[D]").item().isoformat(),
        topic=TOPIC,
        space=SPACE,
        length=len(scans),
        frames=partial(_frames, scans, stamps, poses, boxes, images),
        classes=CLASSES if boxes is not None else (),
        cameras=cameras,
        base_from_lidar=imu_from_lidar,
        notes=tuple(notes),
    )


def _rigid(path: Path) -> Transform:
    values = key_values(path)
    pose: Transform = np.eye(4)
    pose[:3, :3] = matrix_of(values, "R", (3, 3), path)
    pose[:3, 3] = matrix_of(values, "T", (3, 1), path)[:, 0]
    return pose


def _camera(
    folder: Path, scans: Mapping[int, Path], options: ReadOptions
) -> tuple[tuple[CameraModel, ...], dict[int, Picture]]:
    images_folder = folder / "image_02" / "data"
    if not options.with_cameras or not images_folder.is_dir():
        return (), {}
    images = numbered(images_folder, ".png", what="images", gaps=True)
    need_frames_of(list(images), scans, folder=images_folder)
    stamps = stamps_of(images_folder.parent / "timestamps.txt")
    if len(stamps) <= max(images):
        raise DatasetUnusableError(f"image {max(images)} has no time ({images_folder.parent})")
    to_camera, projection = folder.parent / "calib_velo_to_cam.txt", folder.parent
    path = projection / "calib_cam_to_cam.txt"
    values = key_values(path)
    turned = square(matrix_of(values, "R_rect_00", (3, 3), path))
    camera0_from_lidar = turned @ _rigid(to_camera)
    matrix = matrix_of(values, "P_rect_02", (3, 4), path)
    model = rectified(_CAMERA, matrix, camera0_from_lidar, next(iter(images.values())))
    pictures = {number: Picture(_CAMERA, stamps[number], image) for number, image in images.items()}
    return (model,), pictures


def _frames(
    scans: Mapping[int, Path],
    stamps: Sequence[int],
    poses: Mapping[int, Transform] | None,
    boxes: Mapping[int, Sequence[SourceBox]] | None,
    images: Mapping[int, Picture],
) -> Iterator[SourceFrame]:
    numbers = TrackNumbers()
    for number, path in scans.items():
        points = read_floats(path, 4)
        pose = None if poses is None else poses[number]
        truth: dict[str, NDArray[np.generic]] = {}
        objects, label_ids = [], None
        if boxes is not None and pose is not None:
            world = points[:, :3].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
            told = truth_of_boxes(world, boxes.get(number, ()), numbers)
            beyond = np.abs(np.arctan2(points[:, 1], points[:, 0])) > VIEW_RAD
            told.motion[beyond & (told.track < 0)] = 0
            semantic = told.box_class.astype(np.uint8)
            truth = {"motion": told.motion, "track": told.track, "semantic": semantic}
            objects, label_ids = told.objects, _LABEL_OF[semantic]
        yield SourceFrame(
            stamp_ns=stamps[number],
            rows=rows_of(points, points[:, 3]),
            world_from_sensor=pose,
            truth=truth,
            tracks=objects,
            pictures=[images[number]] if number in images else (),
            label_ids=label_ids,
        )
