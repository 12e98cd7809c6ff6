"""ONCE: sequences at 2 Hz with poses, boxes of some frames, and seven cameras.

Sources: once-for-auto-driving.github.io; github.com/once-for-auto-driving/once_devkit.
"""

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from schemas.arrays import NS_PER_S, Transform
from workers.lab.datasets.conversion.boxes import SourceBox, TrackNumbers, truth_of_boxes
from workers.lab.datasets.conversion.source import (
    CameraModel,
    ClassRow,
    DatasetUnusableError,
    Picture,
    SourceFrame,
    SourceLog,
)
from workers.lab.datasets.published.files import image_size, read_floats, read_json, rows_of
from workers.lab.datasets.published.options import ReadOptions
from workers.lab.datasets.published.poses import pose_of

CLASSES: Final = (
    ClassRow(1, "Car", 1, movable=True, label=10),
    ClassRow(2, "Truck", 4, movable=True, label=18),
    ClassRow(3, "Bus", 5, movable=True, label=13),
    ClassRow(4, "Pedestrian", 6, movable=True, label=30),
    ClassRow(5, "Cyclist", 7, movable=True, label=31),
)
_ID_OF: Final = {row.name: row.class_id for row in CLASSES}
_LABELS: Final = np.array([0, *(row.label for row in CLASSES)], np.uint32)

AHEAD_FROM_LIDAR: Final[Transform] = np.array(
    [[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""From ONCE's axes, x left and y back, to x ahead and y left: signs and order alone."""

_NS_PER_MS: Final = 1_000_000
_LIDAR_FOLDER: Final = "lidar_roof"
_CAMERA_FOLDER: Final = "cam01"
_CAMERA: Final = "front"
_TOPIC: Final = "/lidar/roof/points"
_SPACE: Final = "lidar_roof"


def find_logs(source: Path, options: ReadOptions) -> list[SourceLog]:
    """Find the sequences of a folder: the root, `data`, or one sequence."""
    if (source / _LIDAR_FOLDER).is_dir():
        return [_log(source, options)]
    found = sorted(
        path.parent
        for pattern in ("", "data/", "*/data/")
        for path in source.glob(f"{pattern}*/{_LIDAR_FOLDER}")
    )
    return [_log(each, options) for each in found]


def _log(folder: Path, options: ReadOptions) -> SourceLog:
    path = folder / f"{folder.name}.json"
    stated = read_json(path)
    try:
        frames = list(stated["frames"])
        stamps = [int(frame["frame_id"]) * _NS_PER_MS for frame in frames]
        poses = [_pose(frame) for frame in frames]
        calibration = stated["calib"]
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetUnusableError(
            f"no sequence of ONCE: {type(error).__name__}: {error} ({path})"
        ) from None
    if not frames:
        raise DatasetUnusableError(f"no frame in {path}")
    for frame in frames:
        if not (folder / _LIDAR_FOLDER / f"{frame['frame_id']}.bin").is_file():
            raise DatasetUnusableError(
                f"frame {frame['frame_id']} is missing in {folder / _LIDAR_FOLDER}"
            )
    annotated = sum("annos" in frame for frame in frames)
    notes = [
        "points: turned by 90 degrees, so that x is ahead",
        f"classes: of the boxes of {annotated} of {len(frames)} frames; ONCE's boxes have no "
        "tracks, so this truth has no motion",
    ]
    return SourceLog(
        name=f"once-{folder.name}",
        vehicle="once",
        date=datetime.fromtimestamp(stamps[0] / NS_PER_S, UTC).strftime("%Y-%m-%d"),
        topic=_TOPIC,
        space=_SPACE,
        length=len(frames),
        frames=partial(_frames, folder, frames, stamps, poses, options),
        classes=CLASSES,
        cameras=_camera(folder, calibration, frames, options),
        notes=tuple(notes),
    )


def _pose(frame: Mapping[str, Any]) -> Transform:
    x, y, z, w, *place = (float(each) for each in frame["pose"])
    pose: Transform = pose_of(place, (w, x, y, z)) @ np.linalg.inv(AHEAD_FROM_LIDAR)
    return pose


def _camera(
    folder: Path,
    calibration: Mapping[str, Any],
    frames: Sequence[Mapping[str, Any]],
    options: ReadOptions,
) -> tuple[CameraModel, ...]:
    images = folder / _CAMERA_FOLDER
    if not options.with_cameras or not images.is_dir():
        return ()
    known = {str(frame["frame_id"]) for frame in frames}
    listed = sorted(images.glob("*.jpg"))
    lacking = next((path for path in listed if path.stem not in known), None)
    if lacking is not None:
        raise DatasetUnusableError(f"image without a lidar frame: {lacking}")
    if not listed:
        return ()
    try:
        stated = calibration[_CAMERA_FOLDER]
        own_from_camera = np.array(stated["cam_to_velo"], np.float64).reshape(4, 4)
        intrinsics = np.array(stated["cam_intrinsic"], np.float64).reshape(3, 3)
        distortion = tuple(float(each) for each in np.ravel(stated.get("distortion", ())))
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetUnusableError(
            f"no calibration of {_CAMERA_FOLDER}: {type(error).__name__}: {error} ({folder})"
        ) from None
    width, height = image_size(listed[0])
    return (
        CameraModel(
            name=_CAMERA,
            width=width,
            height=height,
            intrinsics=intrinsics,
            lidar_from_camera=AHEAD_FROM_LIDAR @ own_from_camera,
            distortion=distortion or (0.0,) * 5,
        ),
    )


def _frames(
    folder: Path,
    frames: Sequence[Mapping[str, Any]],
    stamps: Sequence[int],
    poses: Sequence[Transform],
    options: ReadOptions,
) -> Iterator[SourceFrame]:
    for frame, stamp_ns, pose in zip(frames, stamps, poses, strict=True):
        path = folder / _LIDAR_FOLDER / f"{frame['frame_id']}.bin"
        own = read_floats(path, 4)
        points = np.stack([-own[:, 1], own[:, 0], own[:, 2]], axis=1)
        truth, label_ids = {}, None
        if "annos" in frame:
            boxes = _boxes(frame, pose, path)
            world = points.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
            semantic = truth_of_boxes(world, boxes, TrackNumbers()).box_class.astype(np.uint8)
            truth, label_ids = {"semantic": semantic}, _LABELS[semantic]
        image = folder / _CAMERA_FOLDER / f"{frame['frame_id']}.jpg"
        shown = options.with_cameras and image.is_file()
        yield SourceFrame(
            stamp_ns=stamp_ns,
            rows=rows_of(points, own[:, 3]),
            world_from_sensor=pose,
            truth=truth,
            pictures=[Picture(_CAMERA, stamp_ns, image)] if shown else (),
            label_ids=label_ids,
        )


def _boxes(frame: Mapping[str, Any], pose: Transform, path: Path) -> list[SourceBox]:
    boxes = []
    annotations = frame["annos"]
    for number, (name, box) in enumerate(
        zip(annotations["names"], annotations["boxes_3d"], strict=False)
    ):
        if name not in _ID_OF:
            raise DatasetUnusableError(f"the class {name!r} of {path.stem} is none of ONCE's")
        x, y, z, length, width, height, yaw = (float(each) for each in box)
        own_from_box = np.eye(4)
        own_from_box[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
        own_from_box[:3, 3] = (x, y, z)
        boxes.append(
            SourceBox(
                uuid=f"{path.stem}-{number}",
                name=name,
                class_id=_ID_OF[name],
                movable=True,
                world_from_box=pose @ AHEAD_FROM_LIDAR @ own_from_box,
                size_m=(length, width, height),
            )
        )
    return boxes
