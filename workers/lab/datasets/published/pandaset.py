"""PandaSet: pickled frames in the world, undone to what the Pandar64 measured.

Source: github.com/scaleapi/pandaset-devkit. Points are stored in the world without the motion of
the car, in a frame whose origin is not the sensor.
"""

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from schemas.arrays import NS_PER_S, Transform
from workers.lab.datasets.conversion.boxes import (
    SourceBox,
    TrackNumbers,
    truth_of_boxes,
    with_velocities,
)
from workers.lab.datasets.conversion.source import (
    CameraModel,
    DatasetUnusableError,
    Picture,
    SourceFrame,
    SourceLog,
)
from workers.lab.datasets.published.files import image_size, numbered, read_json
from workers.lab.datasets.published.frame_pickles import read_frame
from workers.lab.datasets.published.options import ReadOptions
from workers.lab.datasets.published.pandaset_classes import CLASSES, STATIC_LABELS
from workers.lab.datasets.published.poses import pose_of
from workers.lab.evaluation.truth.trajectory import Trajectory, applied, unapplied

ROWS: Final = np.dtype(
    [
        *(("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")),
        *(("t", "<u4"), ("ring", "<u2")),
    ]
)
MECHANICAL: Final = 0
"""Number of the spinning lidar in the column `d`; 1 is the forward PandarGT."""

_BOX_SENSORS: Final = (-1, 0)
"""Sensors of boxes: those of both lidars, and of the spinning one."""

AHEAD_FROM_EGO: Final[Transform] = np.array(
    [[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""From PandaSet's axes of the car, x right and y ahead, to x ahead and y left."""

BASE_FROM_LIDAR: Final = pose_of(
    (0.7819250341441979, -0.0008757909998281726, 1.8593849501974722),
    (0.9999690014658693, -0.00025466961894443266, -0.00786964082538702, 2.004220558130239e-06),
)
"""Mounting of the Pandar64, metres, where its 64 rings are cones; PandaSet does not state it."""

ELEVATIONS_DEG: Final = (
    14.871, 11.021, 8.048, 5.046, 3.029, 2.017, 1.849, 1.677, 1.511, 1.34, 1.173, 1.002, 0.834,
    0.663, 0.497, 0.326, 0.158, -0.012, -0.181, -0.349, -0.52, -0.687, -0.857, -1.025, -1.196,
    -1.363, -1.534, -1.7, -1.872, -2.04, -2.21, -2.377, -2.548, -2.712, -2.885, -3.052, -3.222,
    -3.387, -3.56, -3.724, -3.896, -4.062, -4.233, -4.397, -4.57, -4.732, -4.904, -5.069, -5.241,
    -5.403, -5.577, -5.738, -5.91, -6.073, -7.075, -8.071, -9.072, -9.897, -11.044, -12.018,
    -12.986, -13.942, -18.901, -24.907,
)  # fmt: skip
"""Elevation of each beam of the Pandar64 from the top, degrees; median over 56 sweeps."""

OWN_CAR_M: Final = 2.0
"""Range of returns from the own roof, metres."""

_NS_PER_US: Final = 1000
_CAMERA: Final = "front"
_TOPIC: Final = "/lidar/top/points"
_SPACE: Final = "lidar_top"


def find_logs(source: Path, options: ReadOptions) -> list[SourceLog]:
    """Find the sequences of a folder: the root, or one sequence."""
    if (source / "lidar").is_dir():
        return [_log(source, options)]
    found = sorted(path.parent.parent for path in source.glob("*/lidar/poses.json"))
    return [_log(each, options) for each in found]


def _log(folder: Path, options: ReadOptions) -> SourceLog:
    sweeps = numbered(folder / "lidar", ".pkl.gz", what="sweeps")
    times_ns, bases = trajectory_of(folder / "lidar", len(sweeps))
    path = Trajectory(times_ns, [base @ BASE_FROM_LIDAR for base in bases])
    cuboids = _matching(folder / "annotations" / "cuboids", sweeps, "cuboids")
    semseg = _matching(folder / "annotations" / "semseg", sweeps, "classes of points")
    notes = [
        "points: brought back from the world to the sensor by the poses, which leaves up to "
        "0.05 degrees while driving; only the spinning lidar is written",
        "ring: from the elevation of each point",
    ]
    if cuboids is None:
        notes.append("no cuboids: this truth has no motion")
    cameras, pictures = _camera(folder, bases, times_ns, options)
    return SourceLog(
        name=f"pandaset-{folder.name}",
        vehicle="panda",
        date=datetime.fromtimestamp(times_ns[0] / NS_PER_S, UTC).strftime("%Y-%m-%d"),
        topic=_TOPIC,
        space=_SPACE,
        length=len(sweeps),
        frames=partial(_frames, list(sweeps.values()), path, cuboids, semseg, times_ns, pictures),
        classes=CLASSES if semseg is not None else (),
        cameras=cameras,
        base_from_lidar=BASE_FROM_LIDAR,
        notes=tuple(notes),
    )


def _matching(folder: Path, sweeps: Mapping[int, Path], what: str) -> list[Path] | None:
    if not folder.is_dir():
        return None
    found = numbered(folder, ".pkl.gz", what=what)
    lacking = next((number for number in sweeps if number not in found), None)
    if lacking is not None:
        raise DatasetUnusableError(f"sweep {lacking:02d} has no {what} ({folder})")
    return [found[number] for number in sweeps]


def trajectory_of(folder: Path, sweeps: int) -> tuple[list[int], list[Transform]]:
    """Read the poses of the car, x ahead, and their times, the end of each sweep.

    Raises:
        DatasetUnusableError: If there are fewer than sweeps.
    """
    poses, stamps = read_json(folder / "poses.json"), read_json(folder / "timestamps.json")
    if len(poses) < sweeps or len(stamps) < sweeps:
        raise DatasetUnusableError(
            f"{folder} has {sweeps} sweeps, {len(poses)} poses and {len(stamps)} timestamps"
        )
    try:
        bases = [_pose(each) @ np.linalg.inv(AHEAD_FROM_EGO) for each in poses]
        times_ns = [round(float(each) * NS_PER_S / _NS_PER_US) * _NS_PER_US for each in stamps]
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetUnusableError(
            f"no poses with position and heading: {type(error).__name__}: {error} ({folder})"
        ) from None
    return times_ns[:sweeps], bases[:sweeps]


def _pose(stated: Mapping[str, Mapping[str, float]]) -> Transform:
    position, heading = stated["position"], stated["heading"]
    return pose_of(
        [float(position[name]) for name in "xyz"], [float(heading[name]) for name in "wxyz"]
    )


def _frames(
    sweeps: Sequence[Path],
    path: Trajectory,
    cuboids: Sequence[Path] | None,
    semseg: Sequence[Path] | None,
    times_ns: Sequence[int],
    pictures: Sequence[Sequence[Picture]],
) -> Iterator[SourceFrame]:
    boxes: list[list[SourceBox]] | None = None
    if cuboids is not None:
        boxes = with_velocities([_boxes(each) for each in cuboids], times_ns)
    numbers = TrackNumbers()
    for number, sweep in enumerate(sweeps):
        table = _sweep(sweep)
        classes = None
        if semseg is not None:
            classes = _classes(semseg[number], len(table["x"]))
        spinning = table["d"] == MECHANICAL if "d" in table else np.ones(len(table["x"]), np.bool_)
        chosen = {name: table[name][spinning] for name in ("x", "y", "z", "i", "t")}
        yield _frame(
            chosen,
            path,
            None if boxes is None else boxes[number],
            None if classes is None else classes[spinning],
            numbers,
            pictures[number] if pictures else (),
        )


def _sweep(path: Path) -> dict[str, NDArray[Any]]:
    table = read_frame(path)
    lacking = [name for name in ("x", "y", "z", "i", "t") if name not in table]
    if lacking:
        raise DatasetUnusableError(f"no column {lacking[0]} in {path}")
    return table


def _classes(path: Path, points: int) -> NDArray[np.uint8]:
    table = read_frame(path)
    if "class" not in table or len(table["class"]) != points:
        count = len(table.get("class", ()))
        raise DatasetUnusableError(
            f"{path} labels {count} points, its sweep has {points}: labels and sweeps are not of "
            "one release"
        )
    classes = table["class"].astype(np.int64)
    unknown = np.setdiff1d(classes, [0, *(each.class_id for each in CLASSES)])
    if len(unknown):
        raise DatasetUnusableError(
            f"{path} has the class {unknown[0]}, which is none of PandaSet's"
        )
    return classes.astype(np.uint8)


def _frame(
    sweep: Mapping[str, NDArray[Any]],
    path: Trajectory,
    boxes: Sequence[SourceBox] | None,
    classes: NDArray[np.uint8] | None,
    numbers: TrackNumbers,
    pictures: Sequence[Picture],
) -> SourceFrame:
    world = np.stack([sweep[name].astype(np.float64) for name in "xyz"], axis=1)
    first_s = float(sweep["t"].min()) if len(world) else 0.0
    stamp_ns = round(first_s * NS_PER_S / _NS_PER_US) * _NS_PER_US
    offset_ns = np.rint((sweep["t"] - first_s) * NS_PER_S).astype(np.int64)
    poses, which = path.at_each(stamp_ns + offset_ns)
    points = unapplied(poses, which, world)
    rows = np.zeros(len(points), ROWS)
    rows["x"], rows["y"], rows["z"] = points.T
    rows["intensity"], rows["t"] = sweep["i"], offset_ns
    rows["ring"] = rings_of(points)
    truth: dict[str, NDArray[Any]] = {}
    label_ids = None
    of_class: dict[str, NDArray[np.bool_]] = {}
    if classes is not None:
        of_class = {
            "movable": _table(lambda row: row.movable)[classes],
            "ground": _table(lambda row: row.is_ground)[classes],
            "noise": (classes == 0) | _table(lambda row: row.noise)[classes],
        }
        ground = of_class["ground"].astype(np.uint8)
        ground[of_class["noise"]] = 255
        truth |= {"semantic": classes, "ground": ground}
    truth["ego"] = (np.linalg.norm(points, axis=1) < OWN_CAR_M).astype(np.uint8)
    objects = []
    if boxes is not None:
        told = truth_of_boxes(world, boxes, numbers, **of_class)
        told.motion[truth["ego"] == 1] = 0
        truth |= {"motion": told.motion, "track": told.track}
        objects = told.objects
    if classes is not None:
        label_ids = STATIC_LABELS[classes]
    return SourceFrame(
        stamp_ns=stamp_ns,
        rows=rows,
        world_from_sensor=path.at(np.array([stamp_ns]))[0],
        truth=truth,
        tracks=objects,
        pictures=pictures,
        label_ids=label_ids,
    )


def _table(of: Any) -> NDArray[np.bool_]:
    table = np.zeros(256, np.bool_)
    for row in CLASSES:
        table[row.class_id] = of(row)
    return table


def rings_of(points_m: NDArray[np.float64]) -> NDArray[np.uint16]:
    """Return the beam of each point by its elevation, 0 at the top."""
    across = np.hypot(points_m[:, 0], points_m[:, 1])
    elevation = np.degrees(np.arctan2(points_m[:, 2], across))
    rising = np.array(ELEVATIONS_DEG[::-1])
    between = (rising[1:] + rising[:-1]) / 2
    beam = len(rising) - 1 - np.searchsorted(between, elevation)
    return np.asarray(beam, np.uint16)


def _boxes(path: Path) -> list[SourceBox]:
    table = read_frame(path)
    needed = (
        *("uuid", "label", "yaw", "position.x", "position.y", "position.z"),
        *("dimensions.x", "dimensions.y", "dimensions.z"),
    )
    lacking = [name for name in needed if name not in table]
    if lacking:
        raise DatasetUnusableError(f"no column {lacking[0]} in {path}")
    boxes = []
    for row in range(len(table["uuid"])):
        sensor = int(table["cuboids.sensor_id"][row]) if "cuboids.sensor_id" in table else -1
        if sensor not in _BOX_SENSORS:
            continue
        pose = np.eye(4)
        # PandaSet turns boxes about their width
        yaw = float(table["yaw"][row]) + np.pi / 2
        pose[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
        pose[:3, 3] = [float(table[f"position.{axis}"][row]) for axis in "xyz"]
        width, length, height = (float(table[f"dimensions.{axis}"][row]) for axis in "xyz")
        name = str(table["label"][row])
        boxes.append(
            SourceBox(
                uuid=str(table["uuid"][row]),
                name=name,
                class_id=0,
                movable=name not in _STANDING,
                world_from_box=pose,
                size_m=(length, width, height),
            )
        )
    return boxes


_STANDING: Final = (
    *("Cones", "Signs", "Rolling Containers", "Temporary Construction Barriers"),
    *("Construction Signs", "Pylons", "Road Barriers"),
)
"""Labels of cuboids that cannot move by themselves."""


def _camera(
    folder: Path, bases: Sequence[Transform], times_ns: Sequence[int], options: ReadOptions
) -> tuple[tuple[CameraModel, ...], list[list[Picture]]]:
    """Read the front camera; its mounting is that of its first image."""
    camera = folder / "camera" / "front_camera"
    if not options.with_cameras or not camera.is_dir():
        return (), []
    images = numbered(camera, ".jpg", what="images")
    stamps, poses = read_json(camera / "timestamps.json"), read_json(camera / "poses.json")
    stated = read_json(camera / "intrinsics.json")
    if len(images) != len(bases):
        raise DatasetUnusableError(
            f"{camera} has {len(images)} images, the lidar {len(bases)} sweeps: unpack both again, "
            "or leave cameras out with --cameras none"
        )
    if len(stamps) < len(images) or len(poses) < len(images):
        raise DatasetUnusableError(f"images without a time or a pose ({camera})")
    intrinsics = np.eye(3)
    intrinsics[0, 0], intrinsics[1, 1] = stated["fx"], stated["fy"]
    intrinsics[0, 2], intrinsics[1, 2] = stated["cx"], stated["cy"]
    at_ns = [round(float(each) * NS_PER_S / _NS_PER_US) * _NS_PER_US for each in stamps]
    base = Trajectory(times_ns, bases).at(np.array([at_ns[0]]))[0]
    lidar_from_camera = np.linalg.inv(base @ BASE_FROM_LIDAR) @ _pose(poses[0])
    width, height = image_size(next(iter(images.values())))
    model = CameraModel(_CAMERA, width, height, intrinsics, lidar_from_camera)
    pictures = [
        [Picture(_CAMERA, at_ns[number], path)] for number, path in enumerate(images.values())
    ]
    return (model,), pictures


def world_of(
    points_m: NDArray[np.float64], times_ns: NDArray[np.int64], path: Trajectory
) -> NDArray[np.float64]:
    """Map measured points to PandaSet's world, each by the pose at its own time."""
    poses, which = path.at_each(times_ns)
    return applied(poses, which, points_m)
