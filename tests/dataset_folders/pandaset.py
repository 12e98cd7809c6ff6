"""Folders of PandaSet from the reference log: points in the world, cuboids, classes, poses."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Transform
from tests.dataset_folders.old_pickles import write_frame
from tests.dataset_folders.real_logs import RealLog, intensity_of, wxyz, xyz_of
from workers.lab.datasets.published.pandaset import AHEAD_FROM_EGO, BASE_FROM_LIDAR, world_of
from workers.lab.evaluation.truth.trajectory import Trajectory


def write_pandaset(root: Path, log: RealLog, frames: int) -> Path:
    """Write the sequence 002 of as many sweeps, whose poses are those of the data set."""
    folder = root / "002"
    with np.load(log.truth / "poses.npz") as arrays:
        times_ns = arrays["reference_time_ns"][:frames]
        of_lidar = arrays["world_from_lidar_at_reference"][:frames]
    bases = of_lidar @ np.linalg.inv(BASE_FROM_LIDAR)
    of_json = [_stated(base @ AHEAD_FROM_EGO) for base in bases]
    (folder / "lidar").mkdir(parents=True)
    (folder / "lidar" / "poses.json").write_text(json.dumps(of_json))
    stamps = [int(each) / NS_PER_S for each in times_ns]
    (folder / "lidar" / "timestamps.json").write_text(json.dumps(stamps))
    path = Trajectory(times_ns.tolist(), [base @ BASE_FROM_LIDAR for base in bases])
    tracks = log.tracks()
    for number, cloud in zip(range(frames), log.clouds(), strict=False):
        seconds = (cloud.stamp_ns + cloud.fields["t"].astype(np.int64)) / NS_PER_S
        # the times that a reader finds are those of the doubles in the file
        first_ns = round(float(seconds.min()) * NS_PER_S / 1000) * 1000
        offset_ns = np.rint((seconds - seconds.min()) * NS_PER_S).astype(np.int64)
        world = world_of(xyz_of(cloud), first_ns + offset_ns, path)
        sweep = {
            **dict(zip("xyz", world.T, strict=True)),
            "i": intensity_of(cloud).astype(np.float64),
            "t": seconds,
            "d": np.zeros(len(world), np.int64),
        }
        name = f"{number:02d}.pkl.gz"
        write_frame(folder / "lidar" / name, sweep)
        classes = log.labels(number)["semantic"].astype(np.int64)
        write_frame(folder / "annotations" / "semseg" / name, {"class": classes})
        cuboids = [row for row in tracks if int(row["frame"]) == number]
        write_frame(folder / "annotations" / "cuboids" / name, cuboid_columns(cuboids))
    return root


def cuboid_columns(rows: list[dict[str, str]]) -> dict[str, NDArray[Any]]:
    def numbers(name: str) -> NDArray[np.float64]:
        return np.array([float(row[name]) for row in rows])

    return {
        "uuid": np.array([row["uuid"] for row in rows], object),
        "label": np.array([row["class"] for row in rows], object),
        "yaw": numbers("yaw") - np.pi / 2,
        "stationary": np.array([row["stationary_flag"] == "1" for row in rows]),
        "camera_used": np.full(len(rows), -1, np.int64),
        "position.x": numbers("x"),
        "position.y": numbers("y"),
        "position.z": numbers("z"),
        "dimensions.x": numbers("width"),
        "dimensions.y": numbers("length"),
        "dimensions.z": numbers("height"),
        "attributes.object_motion": np.array([row["object_motion_flag"] for row in rows], object),
        "cuboids.sibling_id": np.array(["-"] * len(rows), object),
        "cuboids.sensor_id": np.full(len(rows), -1, np.int64),
    }


def _stated(pose: Transform) -> dict[str, dict[str, float]]:
    place = dict(zip("xyz", pose[:3, 3].tolist(), strict=True))
    return {"position": place, "heading": dict(zip("wxyz", wxyz(pose), strict=True))}
