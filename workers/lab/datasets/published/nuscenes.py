"""nuScenes: JSON tables, sweeps of 32 beams at 20 Hz, boxes and classes of points at 2 Hz.

Sources: nuscenes.org, data format; github.com/nutonomy/nuscenes-devkit, schema.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Transform
from workers.lab.datasets.conversion.boxes import (
    SourceBox,
    TrackNumbers,
    TrackRow,
    truth_of_boxes,
)
from workers.lab.datasets.conversion.source import (
    CameraModel,
    DatasetUnusableError,
    Picture,
    SourceFrame,
    SourceLog,
)
from workers.lab.datasets.published.files import read_bytes, read_floats
from workers.lab.datasets.published.nuscenes_classes import CLASSES
from workers.lab.datasets.published.nuscenes_tables import (
    Sweep,
    Tables,
    boxes_of_sweeps,
    read_tables,
)
from workers.lab.datasets.published.options import ReadOptions
from workers.lab.datasets.published.poses import pose_of

ROWS: Final = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2")]
)
AHEAD_FROM_LIDAR: Final[Transform] = np.array(
    [[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""From the lidar's own axes, x right and y ahead, to x ahead and y left: signs and order alone."""

_TOPIC: Final = "/lidar/top/points"
_SPACE: Final = "lidar_top"
_CAMERA: Final = "front"
_LABELS: Final = np.zeros(256, np.uint32)
_LABELS[[row.class_id for row in CLASSES]] = [row.label for row in CLASSES]


def find_logs(source: Path, options: ReadOptions) -> list[SourceLog]:
    """Find the scenes of a folder that has tables, or of one of its versions."""
    folders = sorted(path.parent for path in source.glob("v1.0-*/scene.json"))
    root = source
    if not folders and (source / "scene.json").is_file():
        folders, root = [source], source.parent
    logs = []
    for folder in folders:
        tables = read_tables(root, folder, with_cameras=options.with_cameras)
        logs += [_log(scene, tables, options) for scene in tables.scenes]
    return logs


def _log(scene: dict[str, str], tables: Tables, options: ReadOptions) -> SourceLog:
    name = scene["name"]
    sweeps = tables.lidar.get(scene["token"], [])
    if not sweeps:
        raise DatasetUnusableError(f"{name} has no sweep of LIDAR_TOP ({tables.root})")
    stated = tables.logs[scene["log_token"]]
    notes = [
        "stamp: the end of a sweep: mine with COUNTERPOINT_STAMP_AT=end",
        "points: turned by 90 degrees, so that x is ahead",
    ]
    boxes = boxes_of_sweeps(sweeps, tables, between=options.between_keyframes)
    if not any(boxes):
        boxes = [None] * len(sweeps)
        notes.append("no boxes: this truth has poses only")
    elif options.between_keyframes:
        notes.append("boxes: at 2 Hz, interpolated for the sweeps between, which is no annotation")
    else:
        notes.append("boxes: at 2 Hz; the sweeps between are not judged")
    mounting = _mounting(tables, sweeps[0].calibration)
    cameras, pictures = _camera(scene["token"], tables, mounting)
    return SourceLog(
        name=f"nuscenes-{name}",
        vehicle=stated.get("vehicle") or "nuscenes",
        date=stated["date_captured"],
        topic=_TOPIC,
        space=_SPACE,
        length=len(sweeps),
        frames=partial(_frames, sweeps, tables, boxes, mounting, pictures),
        classes=CLASSES,
        cameras=cameras,
        base_from_lidar=mounting,
        notes=tuple(notes),
    )


def _mounting(tables: Tables, token: str) -> Transform:
    """Return the pose of the lidar, x ahead, in the space of the car."""
    stated = tables.calibrations[token]
    own = pose_of(stated["translation"], stated["rotation"])
    mounting: Transform = own @ np.linalg.inv(AHEAD_FROM_LIDAR)
    return mounting


def _camera(
    scene: str, tables: Tables, base_from_lidar: Transform
) -> tuple[tuple[CameraModel, ...], list[Picture]]:
    images = tables.camera.get(scene, [])
    if not images:
        return (), []
    stated = tables.calibrations[images[0].calibration]
    base_from_camera = pose_of(stated["translation"], stated["rotation"])
    model = CameraModel(
        name=_CAMERA,
        width=images[0].width,
        height=images[0].height,
        intrinsics=np.array(stated["camera_intrinsic"], np.float64).reshape(3, 3),
        lidar_from_camera=np.linalg.inv(base_from_lidar) @ base_from_camera,
    )
    return (model,), [Picture(_CAMERA, each.stamp_ns, tables.root / each.file) for each in images]


def _frames(
    sweeps: Sequence[Sweep],
    tables: Tables,
    boxes: Sequence[Sequence[SourceBox] | None],
    mounting: Transform,
    pictures: Sequence[Picture],
) -> Iterator[SourceFrame]:
    numbers, shown = TrackNumbers(), 0
    for sweep, placed in zip(sweeps, boxes, strict=True):
        points = read_floats(tables.root / sweep.file, 5)
        if sweep.pose not in tables.poses:
            raise DatasetUnusableError(f"{sweep.file} has no pose in ego_pose.json")
        rows = np.zeros(len(points), ROWS)
        rows["x"], rows["y"], rows["z"] = points[:, 1], -points[:, 0], points[:, 2]
        rows["intensity"], rows["ring"] = points[:, 3], points[:, 4]
        pose = tables.poses[sweep.pose] @ mounting
        until = shown
        while until < len(pictures) and pictures[until].stamp_ns <= sweep.stamp_ns:
            until += 1
        classes = _classes(sweep, tables, len(points))
        truth: dict[str, NDArray[Any]] = {}
        objects, label_ids = list[TrackRow](), None
        if placed is not None:
            places = np.stack([rows[name].astype(np.float64) for name in "xyz"], axis=1)
            told = truth_of_boxes(
                places @ pose[:3, :3].T + pose[:3, 3],
                placed,
                numbers,
                **({} if classes is None else _kinds(classes)),
            )
            truth = {"motion": told.motion, "track": told.track}
            objects = told.objects
            truth["semantic"] = told.box_class.astype(np.uint8) if classes is None else classes
        elif classes is not None:
            truth = {"semantic": classes}
        if classes is not None:
            kinds = _kinds(classes)
            ground = kinds["ground"].astype(np.uint8)
            ground[kinds["noise"]] = 255
            truth["ground"] = ground
        if "semantic" in truth:
            label_ids = _LABELS[truth["semantic"]]
        yield SourceFrame(
            stamp_ns=sweep.stamp_ns,
            rows=rows,
            world_from_sensor=pose,
            truth=truth,
            tracks=objects,
            pictures=pictures[shown:until],
            label_ids=label_ids,
        )
        shown = until


def _classes(sweep: Sweep, tables: Tables, points: int) -> NDArray[np.uint8] | None:
    name = tables.classes_file.get(sweep.token)
    if name is None:
        return None
    path = tables.root / name
    classes = np.frombuffer(read_bytes(path), np.uint8)
    if len(classes) != points:
        raise DatasetUnusableError(
            f"{path} labels {len(classes)} points, {sweep.file} has {points}: labels and sweeps "
            "are not of one release"
        )
    if len(classes) and int(classes.max()) >= len(CLASSES):
        raise DatasetUnusableError(
            f"{path} has the class {int(classes.max())}, which is none of nuScenes'"
        )
    return classes


def _kinds(classes: NDArray[np.uint8]) -> dict[str, NDArray[np.bool_]]:
    """Return which points are movable, ground, or no object."""
    tables = {
        "movable": np.array([row.movable for row in CLASSES]),
        "ground": np.array([row.is_ground for row in CLASSES]),
        "noise": np.array([row.noise for row in CLASSES]),
    }
    return {name: table[classes] for name, table in tables.items()}
