"""Folders of Argoverse 2 from the reference pair: feather files of sweeps, boxes and poses."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import feather
from scipy.spatial.transform import Rotation

from schemas.arrays import NS_PER_S, Transform
from tests.dataset_folders.real_logs import RealLog, wxyz
from workers.lab.datasets.published.argoverse2 import ROWS

AROUND_NS = (-300_000_000, -200_000_000, -100_000_000)
"""Annotated times before and after the pair: the pack's velocities were fitted over these."""


def write_argoverse2(root: Path, log: RealLog) -> Path:
    """Write the pair as one log; before and after it boxes move at the velocity of truth."""
    folder = root / "val" / "7fab2350"
    (folder / "sensors" / "lidar").mkdir(parents=True)
    (folder / "map").mkdir()
    (folder / "map" / "log_map_archive_7fab2350____PIT_city_31557.json").write_text("{}")
    with np.load(log.truth / "poses.npz") as arrays:
        stamps, poses = arrays["stamp_ns"], arrays["world_from_lidar_at_stamp"]
    for cloud in log.clouds():
        path = folder / "sensors" / "lidar" / f"{cloud.stamp_ns}.feather"
        write_feather(path, {name: cloud.fields[name] for name in ROWS.names or ()})
    times = [int(stamps[0]) + each for each in AROUND_NS]
    times += [*map(int, stamps), *(int(stamps[1]) - each for each in AROUND_NS)]
    of_car = [poses[0]] * len(AROUND_NS) + [*poses] + [poses[1]] * len(AROUND_NS)
    write_feather(
        folder / "city_SE3_egovehicle.feather",
        {"timestamp_ns": np.array(times), **pose_columns(of_car)},
    )
    rows = _annotations(log.tracks(), times, of_car, len(AROUND_NS))
    write_feather(folder / "annotations.feather", rows)
    return root


def _annotations(
    tracks: list[dict[str, str]], times: list[int], of_car: list[Transform], first: int
) -> dict[str, NDArray[Any]]:
    """Return the boxes of the two sweeps, and of the times around them."""
    listed: list[tuple[int, dict[str, str], Transform]] = []
    for row in tracks:
        number = first + int(row["frame"])
        own = np.eye(4)
        own[:3, :3] = Rotation.from_euler("z", float(row["yaw"])).as_matrix()
        own[:3, 3] = [float(row[name]) for name in "xyz"]
        listed.append((number, row, own))
        velocity = np.array([float(row["vx"]), float(row["vy"]), 0.0])
        beyond = range(first) if row["frame"] == "0" else range(first + 2, len(times))
        for other in beyond:
            world = of_car[number] @ own
            world[:3, 3] += velocity * (times[other] - times[number]) / NS_PER_S
            listed.append((other, row, np.linalg.inv(of_car[other]) @ world))
    return {
        "timestamp_ns": np.array([times[number] for number, _, _ in listed]),
        "track_uuid": np.array([row["uuid"] for _, row, _ in listed]),
        "category": np.array([row["class"] for _, row, _ in listed]),
        **{
            f"{side}_m": np.array([float(row[side]) for _, row, _ in listed])
            for side in ("length", "width", "height")
        },
        **pose_columns([pose for _, _, pose in listed]),
        "num_interior_pts": np.array([int(row["points_inside"]) for _, row, _ in listed]),
    }


def pose_columns(poses: list[Transform]) -> dict[str, NDArray[np.float64]]:
    names = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
    rows = np.array([[*wxyz(pose), *pose[:3, 3]] for pose in poses])
    return dict(zip(names, rows.T, strict=True))


def write_feather(path: Path, columns: dict[str, NDArray[Any]]) -> None:
    arrays = {name: pa.array(np.ascontiguousarray(values)) for name, values in columns.items()}
    feather.write_feather(pa.table(arrays), str(path), compression="zstd")
