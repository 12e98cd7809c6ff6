"""True boxes of a drive: from `tracks.csv` and the poses of truth into the space of its frames."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Transform
from schemas.frame import PosedFrame
from workers.lab.evaluation.failures.planting.drive import DriveActor
from workers.lab.evaluation.truth.trajectory import TRUE_POSES, Trajectory
from workers.lab.evaluation.truth.truth import LogTruth
from workers.lab.simulation.faults.detected_boxes import Body
from workers.lab.simulation.models.kinds import MOVABLE
from workers.points.se3 import inverse

_ENDS: Final = (0.02, 0.98)
"""Quantiles of an object's points along its box that are its ends: a few points are not its own."""

_LAG_S: Final = 0.1
"""Truth's box is off by no more than its object drives in one sweep: this is the fault known."""

_NEEDED: Final = ("x", "y", "z", "yaw", "length", "width", "height")


@dataclass(frozen=True, slots=True, eq=False)
class TrueBox:
    """One row of `tracks.csv`, in the world of the poses of truth.

    Attributes:
        centre_m: (3,) centre.
        yaw_rad: Heading about z.
        size_m: (3,) length, width, height.
        velocity: (3,) over the ground, metres per second; zeros where truth states none.
    """

    centre_m: NDArray[np.float64]
    yaw_rad: float
    size_m: NDArray[np.float64]
    velocity: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class FolderBoxes:
    """Boxes of one part of a log, and the poses that place them.

    Attributes:
        by_frame: Boxes by the frame's number in the folder and by track.
        poses: World from lidar over time.
    """

    by_frame: Mapping[int, Mapping[int, TrueBox]]
    poses: Trajectory


def states_boxes(truth: LogTruth, number: int) -> bool:
    """Test whether truth has boxes for a frame, and the poses that place them."""
    folder = _boxes_in(truth.folder_of(number))
    return folder is not None and truth.index_of(number) in folder.by_frame


def boxes_of_frame(
    truth: LogTruth, number: int, posed: PosedFrame, track: NDArray[np.int16]
) -> dict[int, Body]:
    """Return the true boxes of the objects of a frame that have points, where its points are.

    Truth has a box where it was when the beam met it. A recorded cloud is not deskewed, so the box
    is placed by the true pose at the median time of the object's points. A box that lags behind a
    fast object is moved along its heading onto the object's points, by no more than the object
    drives in one sweep. The box of an object at rest stays where truth has it.

    Args:
        truth: Truth of the log.
        number: Number of the frame in it.
        posed: The frame with its pose.
        track: (N,) object of each point, -1 none.

    Returns:
        Boxes in odom space by track, without a class; empty where truth states none.
    """
    folder = _boxes_in(truth.folder_of(number))
    if folder is None:
        return {}
    frame = posed.frame
    placed: dict[int, Body] = {}
    boxes = folder.by_frame.get(truth.index_of(number), {})
    for each in np.unique(track[track >= 0]).tolist():
        if each not in boxes:
            continue
        mine = track == each
        met_ns = frame.stamp_ns + int(np.median(frame.offset_ns[mine]))
        world_from_sensor = folder.poses.at(np.array([met_ns]))[0]
        body = _in_odom(boxes[each], posed.odom_from_sensor @ inverse(world_from_sensor))
        pose = posed.odom_from_sensor
        placed[each] = _onto(body, frame.points_m[mine] @ pose[:3, :3].T + pose[:3, 3])
    return placed


def detected_bodies(
    boxes: Mapping[int, Body], actors: Sequence[DriveActor], moving: Sequence[bool]
) -> dict[int, Body]:
    """Return the boxes that a detector of road users looks for, with their classes.

    They are those of the movable classes, and those of any other object that moves in the drive.

    Args:
        boxes: True boxes of a frame, by track.
        actors: Objects of the drive.
        moving: Whether each object ever moves.
    """
    return {
        track: Body(
            actors[track].street_class.name.lower(),
            body.centre_m,
            body.yaw_rad,
            body.size_m,
            body.velocity,
        )
        for track, body in sorted(boxes.items())
        if actors[track].street_class in MOVABLE or moving[track]
    }


def _in_odom(box: TrueBox, odom_from_world: Transform) -> Body:
    turn = odom_from_world[:3, :3]
    ahead = turn @ np.array([np.cos(box.yaw_rad), np.sin(box.yaw_rad), 0.0])
    return Body(
        "",
        turn @ box.centre_m + odom_from_world[:3, 3],
        float(np.arctan2(ahead[1], ahead[0])),
        box.size_m,
        (turn @ box.velocity)[:2],
    )


def _onto(body: Body, places_m: NDArray[np.float64]) -> Body:
    """Move a box along its heading by the least way that brings its object's points inside.

    Args:
        body: The box.
        places_m: (N, 3) points of its object, N >= 1, in the space of the box.

    Returns:
        The box, moved by no more than its object drives in one sweep.
    """
    ahead = np.array([np.cos(body.yaw_rad), np.sin(body.yaw_rad), 0.0])
    low_m, high_m = np.quantile((places_m - body.centre_m) @ ahead, _ENDS)
    half_m = float(body.size_m[0]) / 2
    before_m, behind_m = max(0.0, high_m - half_m), max(0.0, -half_m - low_m)
    if before_m and behind_m:  # longer than its box: no place contains it
        return body
    most_m = _LAG_S * float(np.hypot(*body.velocity))
    moved_m = float(np.clip(before_m - behind_m, -most_m, most_m))
    return replace(body, centre_m=body.centre_m + ahead * moved_m)


@lru_cache(maxsize=4)
def _boxes_in(folder: Path) -> FolderBoxes | None:
    table, poses = folder / "tracks.csv", folder / TRUE_POSES
    if not table.is_file() or not poses.is_file():
        return None
    found: dict[int, dict[int, TrueBox]] = {}
    with table.open(newline="") as file:
        for row in csv.DictReader(file):
            if all(row.get(name) for name in _NEEDED):
                found.setdefault(int(row["frame"]), {})[int(row["track_id"])] = _box(row)
    with np.load(poses) as arrays:
        times_ns, at = arrays["stamp_ns"], arrays["world_from_lidar_at_stamp"]
    if not found or len(times_ns) < 2:
        return None
    return FolderBoxes(found, _extended(times_ns, at))


def _box(row: Mapping[str, str]) -> TrueBox:
    x, y, z, yaw, *size = (float(row[name]) for name in _NEEDED)
    velocity = [float(row.get(name) or 0.0) for name in ("vx", "vy", "vz")]
    return TrueBox(np.array([x, y, z]), yaw, np.array(size), np.array(velocity))


def _extended(times_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> Trajectory:
    """Return the poses over time with one more step at its end, where the last sweep goes on."""
    step = inverse(poses[-2]) @ poses[-1]
    times = [*times_ns.tolist(), 2 * int(times_ns[-1]) - int(times_ns[-2])]
    return Trajectory(times, [*poses, poses[-1] @ step])
