"""Argoverse 2, sensor data set: feather files of sweeps, boxes, poses and calibration.

Source: argoverse.github.io/user-guide, sensor dataset. Sweeps are in the space of the car, already
brought to the time of their stamp; both lidars are in one sweep.
"""

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Transform
from workers.lab.datasets.conversion.boxes import (
    SourceBox,
    TrackNumbers,
    TrackRow,
    truth_of_boxes,
    with_velocities,
)
from workers.lab.datasets.conversion.source import (
    CameraModel,
    ClassRow,
    DatasetUnusableError,
    Picture,
    SourceFrame,
    SourceLog,
)
from workers.lab.datasets.published.feather import read_feather
from workers.lab.datasets.published.files import numbered
from workers.lab.datasets.published.options import ReadOptions
from workers.lab.datasets.published.poses import pose_of

ROWS: Final = np.dtype(
    [
        *(("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "u1")),
        *(("laser_number", "u1"), ("offset_ns", "<i4")),
    ]
)

_NAMES: Final[Mapping[str, tuple[int, int]]] = {
    "ANIMAL": (0, 0), "ARTICULATED_BUS": (5, 13), "BICYCLE": (2, 11), "BICYCLIST": (7, 31),
    "BOLLARD": (0, 99), "BOX_TRUCK": (4, 18), "BUS": (5, 13), "CONSTRUCTION_BARREL": (0, 99),
    "CONSTRUCTION_CONE": (0, 99), "DOG": (0, 0), "LARGE_VEHICLE": (5, 20),
    "MESSAGE_BOARD_TRAILER": (5, 20), "MOBILE_PEDESTRIAN_CROSSING_SIGN": (19, 81),
    "MOTORCYCLE": (3, 15), "MOTORCYCLIST": (8, 32), "OFFICIAL_SIGNALER": (6, 30),
    "PEDESTRIAN": (6, 30), "RAILED_VEHICLE": (5, 16), "REGULAR_VEHICLE": (1, 10),
    "SCHOOL_BUS": (5, 13), "SIGN": (19, 81), "STOP_SIGN": (19, 81), "STROLLER": (0, 0),
    "TRAFFIC_LIGHT_TRAILER": (5, 20), "TRUCK": (4, 18), "TRUCK_CAB": (4, 18),
    "VEHICULAR_TRAILER": (5, 20), "WHEELCHAIR": (0, 0), "WHEELED_DEVICE": (0, 0),
    "WHEELED_RIDER": (0, 0),
}  # fmt: skip
"""Category to the number of 19 and the `.label` id of SemanticKITTI; 0 where it has no such class.
"""

_STANDING: Final = (
    *("BOLLARD", "CONSTRUCTION_BARREL", "CONSTRUCTION_CONE", "SIGN", "STOP_SIGN"),
    "MOBILE_PEDESTRIAN_CROSSING_SIGN",
)

CLASSES: Final = tuple(
    ClassRow(
        class_id=number,
        name=name,
        semantickitti19=of19,
        movable=name not in _STANDING,
        label=label,
    )
    for number, (name, (of19, label)) in enumerate(_NAMES.items(), 1)
)
"""Ids in the order of the names of the taxonomy; 0 is a point in no box."""

_ID_OF: Final = {row.name: row for row in CLASSES}
_LABEL_OF: Final = np.array([0, *(row.label for row in CLASSES)], np.uint32)
_CAMERA_FOLDER: Final = "ring_front_center"
_CAMERA: Final = "front"
_TOPIC: Final = "/sensors/lidar"
_SPACE: Final = "egovehicle"
_POSE: Final = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")


def find_logs(source: Path, options: ReadOptions) -> list[SourceLog]:
    """Find the logs of a folder: the root, a split, or one log."""
    if (source / "sensors" / "lidar").is_dir():
        return [_log(source, options)]
    found = sorted(
        path.parent.parent
        for pattern in ("*/sensors/lidar", "*/*/sensors/lidar")
        for path in source.glob(pattern)
    )
    return [_log(each, options) for each in found]


def _log(folder: Path, options: ReadOptions) -> SourceLog:
    sweeps = numbered(folder / "sensors" / "lidar", ".feather", what="sweeps", gaps=True)
    poses = _poses(folder / "city_SE3_egovehicle.feather")
    lacking = next((stamp for stamp in sweeps if stamp not in poses), None)
    if lacking is not None:
        raise DatasetUnusableError(
            f"sweep {lacking} has no pose in city_SE3_egovehicle.feather ({folder})"
        )
    annotations = folder / "annotations.feather"
    notes = [
        "points: of both lidars, in the space of the car and brought to the stamp by the data set",
        "classes: of boxes alone; a point in no box has none",
    ]
    if not annotations.is_file():
        notes.append("no annotations.feather: this truth has poses only")
    cameras, images = _camera(folder, options)
    stamps = list(sweeps)
    return SourceLog(
        name=f"av2-{folder.name}",
        vehicle=f"av2-{city}" if (city := _city(folder)) else "av2",
        date=datetime.fromtimestamp(stamps[0] / NS_PER_S, UTC).strftime("%Y-%m-%d"),
        topic=_TOPIC,
        space=_SPACE,
        length=len(sweeps),
        frames=partial(
            _frames, sweeps, poses, annotations if annotations.is_file() else None, images
        ),
        classes=CLASSES if annotations.is_file() else (),
        cameras=cameras,
        notes=tuple(notes),
    )


def _city(folder: Path) -> str:
    """Return the city from the name of the map, `…____PIT_city_…`; empty without a map."""
    for path in sorted((folder / "map").glob("*____*_city_*.json")):
        return path.name.rpartition("____")[2].partition("_city_")[0].lower()
    return ""


def _poses(path: Path) -> dict[int, Transform]:
    table = read_feather(path, ("timestamp_ns", *_POSE))
    stamps = table["timestamp_ns"].astype(np.int64).tolist()
    return {stamp: _row_pose(table, row) for row, stamp in enumerate(stamps)}


def _row_pose(table: Mapping[str, NDArray[Any]], row: int) -> Transform:
    values = [float(table[name][row]) for name in _POSE]
    return pose_of(values[4:], values[:4])


def _frames(
    sweeps: Mapping[int, Path],
    poses: Mapping[int, Transform],
    annotations: Path | None,
    images: Mapping[int, Path],
) -> Iterator[SourceFrame]:
    boxes = None if annotations is None else _boxes(annotations, poses)
    numbers = TrackNumbers()
    waiting = sorted(images.items())
    for stamp_ns, path in sweeps.items():
        table = read_feather(path, ("x", "y", "z", "intensity", "laser_number", "offset_ns"))
        rows = np.zeros(len(table["x"]), ROWS)
        for name in ROWS.names or ():
            rows[name] = table[name]
        pictures = []
        while waiting and waiting[0][0] <= stamp_ns:
            at_ns, image = waiting.pop(0)
            pictures.append(Picture(_CAMERA, at_ns, image))
        truth: dict[str, NDArray[Any]] = {}
        objects, label_ids = list[TrackRow](), None
        if boxes is not None:
            points = np.stack([rows[name].astype(np.float64) for name in "xyz"], axis=1)
            pose = poses[stamp_ns]
            world = points @ pose[:3, :3].T + pose[:3, 3]
            told = truth_of_boxes(world, boxes.get(stamp_ns, ()), numbers)
            semantic = told.box_class.astype(np.uint8)
            truth = {"semantic": semantic, "motion": told.motion, "track": told.track}
            objects, label_ids = told.objects, _LABEL_OF[semantic]
        yield SourceFrame(
            stamp_ns=stamp_ns,
            rows=rows,
            world_from_sensor=poses[stamp_ns],
            truth=truth,
            tracks=objects,
            pictures=pictures,
            label_ids=label_ids,
        )


def _boxes(path: Path, poses: Mapping[int, Transform]) -> dict[int, list[SourceBox]]:
    """Read all boxes, with velocities over the ground, by the stamp of their sweep."""
    needed = ("timestamp_ns", "track_uuid", "category", "length_m", "width_m", "height_m", *_POSE)
    table = read_feather(path, needed)
    found: dict[int, list[SourceBox]] = {}
    for row, stamp in enumerate(table["timestamp_ns"].astype(np.int64).tolist()):
        name = str(table["category"][row])
        known = _ID_OF.get(name)
        if known is None:
            raise DatasetUnusableError(
                f"{path} has the class {name}, which is none of Argoverse 2's"
            )
        if stamp not in poses:
            raise DatasetUnusableError(f"boxes of {stamp} have no pose of the car ({path})")
        found.setdefault(stamp, []).append(
            SourceBox(
                uuid=str(table["track_uuid"][row]),
                name=name,
                class_id=known.class_id,
                movable=known.movable,
                world_from_box=poses[stamp] @ _row_pose(table, row),
                size_m=(
                    float(table["length_m"][row]),
                    float(table["width_m"][row]),
                    float(table["height_m"][row]),
                ),
            )
        )
    stamps = sorted(found)
    moving = with_velocities([found[stamp] for stamp in stamps], stamps)
    return dict(zip(stamps, moving, strict=True))


def _camera(folder: Path, options: ReadOptions) -> tuple[tuple[CameraModel, ...], dict[int, Path]]:
    images_folder = folder / "sensors" / "cameras" / _CAMERA_FOLDER
    if not options.with_cameras or not images_folder.is_dir():
        return (), {}
    images = numbered(images_folder, ".jpg", what="images", gaps=True)
    calibration = folder / "calibration"
    mounted = read_feather(calibration / "egovehicle_SE3_sensor.feather", ("sensor_name", *_POSE))
    lens = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "k3", "height_px", "width_px")
    stated = read_feather(calibration / "intrinsics.feather", ("sensor_name", *lens))
    at = [_row_of(each, calibration) for each in (mounted, stated)]
    values = {name: float(stated[name][at[1]]) for name in lens}
    intrinsics = np.eye(3)
    intrinsics[0, 0], intrinsics[1, 1] = values["fx_px"], values["fy_px"]
    intrinsics[0, 2], intrinsics[1, 2] = values["cx_px"], values["cy_px"]
    model = CameraModel(
        name=_CAMERA,
        width=int(values["width_px"]),
        height=int(values["height_px"]),
        intrinsics=intrinsics,
        lidar_from_camera=_row_pose(mounted, at[0]),
        distortion=(values["k1"], values["k2"], 0.0, 0.0, values["k3"]),
    )
    return (model,), images


def _row_of(table: Mapping[str, NDArray[Any]], folder: Path) -> int:
    names = [str(each) for each in table["sensor_name"]]
    if _CAMERA_FOLDER not in names:
        raise DatasetUnusableError(f"no calibration of {_CAMERA_FOLDER} in {folder}")
    return names.index(_CAMERA_FOLDER)
