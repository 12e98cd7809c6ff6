"""True scene flow of a frame: as truth states it, or from its boxes, tracks and poses."""

import csv
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from schemas.arrays import Transform
from schemas.frame import LidarFrame
from workers.lab.evaluation.truth.trajectory import Trajectory, applied, unapplied
from workers.lab.evaluation.truth.truth import TRUTH_UNKNOWN, LogTruth

Boxes = Mapping[int, Mapping[int, Transform]]
"""Poses of the boxes, (4, 4) world from box, by frame and track."""


@lru_cache(maxsize=4)
def boxes_in(folder: Path) -> Boxes:
    """Read the boxes of `tracks.csv` in the world of its poses; empty where it states none."""
    table = folder / "tracks.csv"
    found: dict[int, dict[int, Transform]] = {}
    if not table.is_file():
        return found
    with table.open(newline="") as file:
        for row in csv.DictReader(file):
            values = [row.get(name) for name in ("x", "y", "z", "yaw")]
            if not all(values):
                continue
            x, y, z, yaw = (float(each or 0) for each in values)
            pose: Transform = np.eye(4)
            pose[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
            pose[:3, 3] = (x, y, z)
            found.setdefault(int(row["frame"]), {})[int(row["track_id"])] = pose
    return found


def true_flow(
    this: LidarFrame,
    following: LidarFrame,
    truth: LogTruth,
    trajectory: Trajectory | None,
    *,
    number: int,
) -> NDArray[np.float32] | None:
    """Return the flow of each point to the next frame, in sensor space.

    Where truth has no array `flow`, static points move with the poses of truth, and those of a
    track with its box. A point of unknown motion, or of a box that the next frame lacks, has none.

    Args:
        this: The frame.
        following: The next frame.
        truth: Truth of the log.
        trajectory: Its true poses; None without them.
        number: Number of the frame.

    Returns:
        (N, 3) metres, NaN where not known; None where truth can give no flow.
    """
    stated = truth.flow_of(this, number=number)
    if stated is not None:
        return stated
    labels = truth.of(this, number=number)
    if trajectory is None or labels is None or labels.track is None:
        return None
    if number + 1 >= len(truth) or truth.folder_of(number) != truth.folder_of(number + 1):
        return None
    boxes = boxes_in(truth.folder_of(number))
    if not boxes:
        return None
    now = boxes.get(truth.index_of(number), {})
    then = boxes.get(truth.index_of(number + 1), {})
    points = this.points_m.astype(np.float64)
    times_ns = this.stamp_ns + this.offset_ns.astype(np.int64)
    poses, which = trajectory.at_each(times_ns)
    later = trajectory.at(np.unique(times_ns) + (following.stamp_ns - this.stamp_ns))
    world = applied(poses, which, points)
    moved = world.copy()
    unknown = (labels.motion == TRUTH_UNKNOWN) | ~this.valid_mask
    for track in np.unique(labels.track[labels.track >= 0]).tolist():
        mine = labels.track == track
        if track not in now or track not in then:
            unknown |= mine
            continue
        carried = then[track] @ np.linalg.inv(now[track])
        moved[mine] = world[mine] @ carried[:3, :3].T + carried[:3, 3]
    flow = (unapplied(later, which, moved) - points).astype(np.float32)
    flow[unknown] = np.nan
    return flow
