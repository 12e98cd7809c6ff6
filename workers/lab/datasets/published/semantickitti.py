"""SemanticKITTI and KITTI odometry: `sequences/NN` with velodyne, labels, poses and calibration.

Sources: semantic-kitti.org, data format; cvlibs.net/datasets/kitti, odometry development kit.
"""

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Transform
from schemas.semantickitti import MOVABLE, MOVING, PLAIN
from workers.lab.datasets.conversion.boxes import DYNAMIC, STATIC, UNKNOWN, TrackRow
from workers.lab.datasets.conversion.source import (
    CameraModel,
    DatasetUnusableError,
    Picture,
    SourceFrame,
    SourceLog,
)
from workers.lab.datasets.published.files import (
    image_size,
    key_values,
    matrix_of,
    need_frames_of,
    numbered,
    pose_rows,
    read_bytes,
    read_floats,
    read_text,
    rows_of,
    square,
)
from workers.lab.datasets.published.options import ReadOptions
from workers.points.se3 import inverse

VEHICLE: Final = "annieway"
TOPIC: Final = "/velodyne_points"
SPACE: Final = "velodyne"

CLASS_19: Final[Mapping[int, int]] = {
    0: 0, 1: 0, 9: 0, 10: 1, 11: 2, 13: 5, 15: 3, 16: 5, 18: 4, 20: 5, 30: 6, 31: 7, 32: 8,
    40: 9, 44: 10, 48: 11, 49: 12, 50: 13, 51: 14, 52: 0, 60: 9, 70: 15, 71: 16, 72: 17, 80: 18,
    81: 19, 99: 0, 251: 0, 252: 1, 253: 7, 254: 6, 255: 8, 256: 5, 257: 5, 258: 4, 259: 5,
}  # fmt: skip
"""Class of 19 of each id, as the benchmark of SemanticKITTI merges them."""

_UNLABELLED: Final = (0, 1)
_GROUND: Final = (40, 44, 48, 49, 60, 72)

_DAYS: Final[Mapping[str, str]] = {
    "00": "2011-10-03", "01": "2011-10-03", "02": "2011-10-03", "03": "2011-09-26",
    **{f"{number:02d}": "2011-09-30" for number in range(4, 11)},
}  # fmt: skip
"""Day of each sequence (odometry development kit); those of the test sequences are not published.
"""

_TEST_DAY: Final = "2011-01-01"
_NOON_S: Final = 12 * 3600
_CAMERA: Final = "front"


def find_logs(source: Path, options: ReadOptions) -> list[SourceLog]:
    """Find the sequences of a folder: the root, `sequences`, or one sequence."""
    for folder in (source / "dataset" / "sequences", source / "sequences", source):
        found = sorted(path.parent for path in folder.glob("[0-9][0-9]/velodyne"))
        if found:
            return [_log(each, options) for each in found]
    if (source / "velodyne").is_dir():
        return [_log(source, options)]
    return []


def _log(folder: Path, options: ReadOptions) -> SourceLog:
    scans = numbered(folder / "velodyne", ".bin", what="scans")
    labels = None
    if (folder / "labels").is_dir():
        labels = numbered(folder / "labels", ".label", what="labels")
        lacking = next((number for number in scans if number not in labels), None)
        if lacking is not None:
            raise DatasetUnusableError(f"scan {lacking} has no labels ({folder / 'labels'})")
    notes = ["times: seconds of times.txt from 12:00 UTC of the day, which KITTI does not give"]
    name = folder.name if folder.name.isdecimal() else folder.name[-2:]
    calibration_path = folder / "calib.txt"
    camera_from_lidar = None
    if calibration_path.is_file():
        values = key_values(calibration_path)
        camera_from_lidar = square(matrix_of(values, "Tr", (3, 4), calibration_path))
    poses = _poses(folder, name, camera_from_lidar, scans)
    if poses is None:
        notes.append("no poses: poses.txt or calib.txt is missing")
    if labels is None:
        notes.append("no labels: this truth has poses only")
    cameras, images = _camera(folder, camera_from_lidar, scans, options)
    date = _DAYS.get(name, _TEST_DAY)
    stamps = _stamps(folder, scans, date)
    return SourceLog(
        name=f"kitti-odometry-{name}",
        vehicle=VEHICLE,
        date=date,
        topic=TOPIC,
        space=SPACE,
        length=len(scans),
        frames=partial(_frames, scans, labels, poses, stamps, images),
        cameras=cameras,
        notes=tuple(notes),
    )


def _poses(
    folder: Path, name: str, camera_from_lidar: Transform | None, scans: Mapping[int, Path]
) -> dict[int, Transform] | None:
    """Read poses of camera 0 as poses of the lidar, relative to its first one."""
    candidates = [folder / "poses.txt", folder.parent.parent / "poses" / f"{name}.txt"]
    path = next((each for each in candidates if each.is_file()), None)
    if path is None or camera_from_lidar is None:
        return None
    rows = pose_rows(path, 12)
    if len(rows) <= max(scans):
        raise DatasetUnusableError(f"{path} has {len(rows)} poses, scan {max(scans)} has none")
    lidar_from_camera = np.linalg.inv(camera_from_lidar)
    return {
        number: lidar_from_camera @ square(rows[number].reshape(3, 4)) @ camera_from_lidar
        for number in scans
    }


def _stamps(folder: Path, scans: Mapping[int, Path], date: str) -> dict[int, int]:
    day_ns = int(np.datetime64(date, "s").astype(np.int64) + _NOON_S) * NS_PER_S
    path = folder / "times.txt"
    try:
        seconds = [float(line) for line in read_text(path).split()]
    except ValueError as error:
        raise DatasetUnusableError(f"no seconds: {error} ({path})") from None
    if len(seconds) <= max(scans):
        raise DatasetUnusableError(f"{path} has {len(seconds)} times, scan {max(scans)} has none")
    return {number: day_ns + round(seconds[number] * NS_PER_S) for number in scans}


def _camera(
    folder: Path,
    camera_from_lidar: Transform | None,
    scans: Mapping[int, Path],
    options: ReadOptions,
) -> tuple[tuple[CameraModel, ...], dict[int, Path]]:
    """Read the left colour camera; KITTI's images are rectified."""
    images_folder = folder / "image_2"
    if not options.with_cameras or camera_from_lidar is None or not images_folder.is_dir():
        return (), {}
    images = numbered(images_folder, ".png", what="images", gaps=True)
    need_frames_of(list(images), scans, folder=images_folder)
    path = folder / "calib.txt"
    projection = matrix_of(key_values(path), "P2", (3, 4), path)
    return (rectified(_CAMERA, projection, camera_from_lidar, next(iter(images.values()))),), images


def rectified(
    name: str, projection: NDArray[np.float64], camera0_from_lidar: Transform, image: Path
) -> CameraModel:
    """Return a rectified camera of KITTI from its projection, whose last column is its baseline."""
    width, height = image_size(image)
    intrinsics = projection[:, :3]
    camera_from_camera0: Transform = np.eye(4)
    camera_from_camera0[:3, 3] = np.linalg.solve(intrinsics, projection[:, 3])
    return CameraModel(
        name=name,
        width=width,
        height=height,
        intrinsics=intrinsics.copy(),
        lidar_from_camera=inverse(camera_from_camera0 @ camera0_from_lidar),
    )


def _frames(
    scans: Mapping[int, Path],
    labels: Mapping[int, Path] | None,
    poses: Mapping[int, Transform] | None,
    stamps: Mapping[int, int],
    images: Mapping[int, Path],
) -> Iterator[SourceFrame]:
    tracks: dict[tuple[int, int], int] = {}
    for number, path in scans.items():
        points = read_floats(path, 4)
        label_ids = None if labels is None else _labels(labels[number], len(points), path)
        pictures = []
        if number in images:
            pictures = [Picture(_CAMERA, stamps[number], images[number])]
        truth: dict[str, NDArray[Any]] = {}
        objects: list[TrackRow] = []
        if label_ids is not None:
            truth, objects = truth_of_labels(label_ids, tracks)
        yield SourceFrame(
            stamp_ns=stamps[number],
            rows=rows_of(points, points[:, 3]),
            world_from_sensor=None if poses is None else poses[number],
            truth=truth,
            tracks=objects,
            pictures=pictures,
            label_ids=label_ids,
        )


def _labels(path: Path, points: int, scan: Path) -> NDArray[np.uint32]:
    data = read_bytes(path)
    if len(data) != 4 * points:
        raise DatasetUnusableError(
            f"{path} labels {len(data) / 4:g} points, {scan} has {points}: labels and scans are "
            "not of one release"
        )
    label_ids = np.frombuffer(data, "<u4")
    unknown = np.setdiff1d(label_ids & 0xFFFF, list(CLASS_19))
    if len(unknown):
        raise DatasetUnusableError(
            f"{path} has the class {unknown[0]}, which is none of SemanticKITTI's"
        )
    return label_ids


def truth_of_labels(
    label_ids: NDArray[np.uint32], tracks: dict[tuple[int, int], int]
) -> tuple[dict[str, NDArray[Any]], list[TrackRow]]:
    """Return the truth of SemanticKITTI's labels: motion by class, tracks by instance.

    Args:
        label_ids: (N,) class in the lower half, instance in the upper one.
        tracks: Numbers of tracks by class and instance, which new ones are added to.
    """
    raw = (label_ids & 0xFFFF).astype(np.uint16)
    instance = (label_ids >> 16).astype(np.uint16)
    to19 = np.zeros(260, np.uint8)
    to19[list(CLASS_19)] = list(CLASS_19.values())
    moving = np.isin(raw, list(MOVING))
    motion = np.where(moving, DYNAMIC, STATIC).astype(np.uint8)
    motion[np.isin(raw, _UNLABELLED)] = UNKNOWN
    ground = np.isin(raw, _GROUND).astype(np.uint8)
    ground[np.isin(raw, _UNLABELLED)] = 255
    track = np.full(len(raw), -1, np.int16)
    objects = []
    known = (instance > 0) & np.isin(raw, [*MOVABLE, *MOVING])
    for of in np.unique(label_ids[known]):
        class_id, number = int(of) & 0xFFFF, int(of) >> 16
        mine = label_ids == of
        # an object that stops keeps its instance and changes its class
        at = tracks.setdefault((int(to19[class_id]), number), len(tracks))
        track[mine] = at
        name = {**PLAIN, **MOVABLE, **MOVING}[class_id].removeprefix("moving-")
        uuid = f"{name}-{number}"
        objects.append(TrackRow(at, name, uuid=uuid, points_inside=int(np.count_nonzero(mine))))
    truth: dict[str, NDArray[Any]] = {
        "semantic19": to19[raw],
        "semantic_raw": raw,
        "motion": motion,
        "track": track,
        "ground": ground,
    }
    return truth, objects
