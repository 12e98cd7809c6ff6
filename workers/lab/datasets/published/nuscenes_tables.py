"""Tables of nuScenes that lead from a scene to its sweeps, boxes and classes of points."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from schemas.arrays import Transform
from workers.lab.datasets.conversion.boxes import SourceBox, with_velocities
from workers.lab.datasets.conversion.source import DatasetUnusableError
from workers.lab.datasets.published.json_tables import rows_in
from workers.lab.datasets.published.nuscenes_classes import ID_OF
from workers.lab.datasets.published.poses import pose_of

LIDAR: Final = "LIDAR_TOP"
CAMERA: Final = "CAM_FRONT"
NS_PER_US: Final = 1000
_AROUND: Final = 1
"""Keyframes before and after, over which a velocity is fitted: they are half a second apart."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """One file of a sensor: its token, sample, time, name, and whether it is a keyframe."""

    token: str
    sample: str
    stamp_ns: int
    file: str
    is_keyframe: bool
    pose: str
    calibration: str
    width: int = 0
    height: int = 0


@dataclass(slots=True)
class Tables:
    """Contents of all tables that the converter needs, by token."""

    root: Path
    scenes: list[dict[str, Any]]
    logs: dict[str, dict[str, Any]]
    scene_of_sample: dict[str, str]
    lidar: dict[str, list[Sweep]] = field(default_factory=dict)
    camera: dict[str, list[Sweep]] = field(default_factory=dict)
    poses: dict[str, Transform] = field(default_factory=dict)
    calibrations: dict[str, dict[str, Any]] = field(default_factory=dict)
    boxes_of_sample: dict[str, list[SourceBox]] = field(default_factory=dict)
    classes_file: dict[str, str] = field(default_factory=dict)


def read_tables(root: Path, folder: Path, *, with_cameras: bool) -> Tables:
    """Read the tables of one version, such as `v1.0-mini`.

    Raises:
        DatasetUnusableError: If a table is missing, cut, or lacks a field.
    """
    try:
        return _read(root, folder, with_cameras=with_cameras)
    except KeyError as error:
        raise DatasetUnusableError(f"a table lacks {error} ({folder})") from None


def _read(root: Path, folder: Path, *, with_cameras: bool) -> Tables:
    tables = Tables(
        root=root,
        scenes=list(rows_in(folder / "scene.json")),
        logs={row["token"]: row for row in rows_in(folder / "log.json")},
        scene_of_sample={
            row["token"]: row["scene_token"] for row in rows_in(folder / "sample.json")
        },
    )
    for row in rows_in(folder / "sample_data.json"):
        name = str(row["filename"])
        of = tables.lidar if f"/{LIDAR}/" in name else tables.camera
        if of is tables.camera and not (with_cameras and f"/{CAMERA}/" in name):
            continue
        scene = tables.scene_of_sample.get(row["sample_token"])
        if scene is not None:
            of.setdefault(scene, []).append(_sweep(row))
    wanted = {
        each.pose
        for of in (tables.lidar, tables.camera)
        for sweeps in of.values()
        for each in sweeps
    }
    for row in rows_in(folder / "ego_pose.json"):
        if row["token"] in wanted:
            tables.poses[row["token"]] = pose_of(row["translation"], row["rotation"])
    for row in rows_in(folder / "calibrated_sensor.json"):
        tables.calibrations[row["token"]] = row
    for of in (tables.lidar, tables.camera):
        for sweeps in of.values():
            sweeps.sort(key=lambda each: each.stamp_ns)
    _read_boxes(folder, tables)
    if (folder / "lidarseg.json").is_file():
        tables.classes_file = {
            row["sample_data_token"]: row["filename"] for row in rows_in(folder / "lidarseg.json")
        }
    return tables


def _sweep(row: Mapping[str, Any]) -> Sweep:
    return Sweep(
        token=row["token"],
        sample=row["sample_token"],
        stamp_ns=int(row["timestamp"]) * NS_PER_US,
        file=row["filename"],
        is_keyframe=bool(row["is_key_frame"]),
        pose=row["ego_pose_token"],
        calibration=row["calibrated_sensor_token"],
        width=int(row.get("width") or 0),
        height=int(row.get("height") or 0),
    )


def _read_boxes(folder: Path, tables: Tables) -> None:
    names = {row["token"]: row["name"] for row in rows_in(folder / "category.json")}
    category = {
        row["token"]: names[row["category_token"]] for row in rows_in(folder / "instance.json")
    }
    for row in rows_in(folder / "sample_annotation.json"):
        name = category[row["instance_token"]]
        known = ID_OF.get(name)
        if known is None:
            raise DatasetUnusableError(
                f"category.json has the class {name}, which is none of nuScenes' ({folder})"
            )
        width, length, height = (float(each) for each in row["size"])
        tables.boxes_of_sample.setdefault(row["sample_token"], []).append(
            SourceBox(
                uuid=row["instance_token"],
                name=name,
                class_id=known.class_id,
                movable=known.movable,
                world_from_box=pose_of(row["translation"], row["rotation"]),
                size_m=(length, width, height),
            )
        )


def boxes_of_sweeps(
    sweeps: Sequence[Sweep], tables: Tables, *, between: bool
) -> list[list[SourceBox] | None]:
    """Return the boxes of each sweep; those between keyframes are interpolated, or None.

    Args:
        sweeps: Sweeps of one scene, in the order of time.
        tables: Tables with the boxes of samples.
        between: Whether boxes are interpolated.
    """
    keys = [number for number, sweep in enumerate(sweeps) if sweep.is_keyframe]
    times = [sweeps[number].stamp_ns for number in keys]
    at_keys = with_velocities(
        [tables.boxes_of_sample.get(sweeps[number].sample, []) for number in keys],
        times,
        around=_AROUND,
    )
    found: list[list[SourceBox] | None] = [None] * len(sweeps)
    for number, boxes in zip(keys, at_keys, strict=True):
        found[number] = boxes
    if between:
        for place in range(len(keys) - 1):
            for number in range(keys[place] + 1, keys[place + 1]):
                share = (sweeps[number].stamp_ns - times[place]) / (times[place + 1] - times[place])
                found[number] = interpolated(at_keys[place], at_keys[place + 1], share)
    return found


def interpolated(
    before: Sequence[SourceBox], after: Sequence[SourceBox], share: float
) -> list[SourceBox]:
    """Interpolate boxes between two keyframes.

    An object that only one of them has stays where it is there, and its velocity is unknown.

    Args:
        before: Boxes of the earlier keyframe.
        after: Boxes of the later one.
        share: Time since the earlier one, as a share of the time between.
    """
    later = {box.uuid: box for box in after}
    earlier = {box.uuid for box in before}
    boxes = []
    for box in before:
        other = later.get(box.uuid)
        boxes.append(_without_velocity(box) if other is None else _between(box, other, share))
    boxes.extend(_without_velocity(box) for box in after if box.uuid not in earlier)
    return boxes


def _between(box: SourceBox, other: SourceBox, share: float) -> SourceBox:
    pose = np.eye(4)
    both = Rotation.from_matrix([box.world_from_box[:3, :3], other.world_from_box[:3, :3]])
    pose[:3, :3] = Slerp([0.0, 1.0], both)(share).as_matrix()
    first, last = box.world_from_box[:3, 3], other.world_from_box[:3, 3]
    pose[:3, 3] = (1 - share) * first + share * last
    velocity = None
    if box.velocity is not None and other.velocity is not None:
        velocity = (1 - share) * box.velocity + share * other.velocity
    return SourceBox(box.uuid, box.name, box.class_id, box.movable, pose, box.size_m, velocity)


def _without_velocity(box: SourceBox) -> SourceBox:
    return SourceBox(box.uuid, box.name, box.class_id, box.movable, box.world_from_box, box.size_m)
