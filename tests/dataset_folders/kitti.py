"""Folders of SemanticKITTI, KITTI raw and KITTI-360 from logs, poses and labels."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from schemas.arrays import NS_PER_S, Transform
from tests.dataset_folders.real_logs import RealLog, intensity_of, xyz_of
from workers.ingest.pointcloud import DecodedCloud
from workers.lab.datasets.published.oxts import EARTH_M
from workers.points.se3 import inverse

CAMERA_FROM_LIDAR: Transform = np.array(
    [
        [0.0043, -0.99995, -0.0080, -0.0120],
        [-0.0072, 0.0080, -0.99994, -0.0540],
        [0.99996, 0.0044, -0.0071, -0.2920],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
"""About KITTI's: made a rotation before it is used."""

LIDAR_FROM_IMU: Transform = np.eye(4)
LIDAR_FROM_IMU[:3, 3] = (-0.8087, 0.3195, -0.7997)

_RAW_OF_19 = {
    0: 0, 1: 10, 2: 11, 3: 15, 4: 18, 5: 20, 6: 30, 7: 31, 8: 32, 9: 40, 10: 44, 11: 48, 12: 49,
    13: 50, 14: 51, 15: 70, 16: 71, 17: 72, 18: 80, 19: 81,
}  # fmt: skip


def camera_from_lidar() -> Transform:
    left, _, right = np.linalg.svd(CAMERA_FROM_LIDAR[:3, :3])
    pose = CAMERA_FROM_LIDAR.copy()
    pose[:3, :3] = left @ right
    return pose


def write_scan(path: Path, cloud: DecodedCloud) -> None:
    rows = np.column_stack([xyz_of(cloud), intensity_of(cloud)]).astype("<f4")
    path.write_bytes(rows.tobytes())


def row_of(pose: Transform) -> str:
    return " ".join(repr(float(each)) for each in pose[:3].ravel())


def write_semantickitti(root: Path, log: RealLog, frames: int) -> Path:
    """Write a sequence 00 with labels, poses of camera 0 and calibration."""
    folder = root / "sequences" / "00"
    for name in ("velodyne", "labels"):
        (folder / name).mkdir(parents=True)
    to_camera = camera_from_lidar()
    poses, times = [], []
    for number, cloud in zip(range(frames), log.clouds(), strict=False):
        write_scan(folder / "velodyne" / f"{number:06d}.bin", cloud)
        labels = kitti_labels(log.labels(number))
        (folder / "labels" / f"{number:06d}.label").write_bytes(labels.astype("<u4").tobytes())
        pose = to_camera @ log.icp_poses()[number] @ np.linalg.inv(to_camera)
        poses.append(row_of(pose))
        times.append(f"{number * 0.1036:.9f}")
    (folder / "poses.txt").write_text("\n".join(poses) + "\n")
    (folder / "times.txt").write_text("\n".join(times) + "\n")
    projections = [f"P{n}: " + row_of(np.eye(4)) for n in range(4)]
    calibration = [*projections, "Tr: " + row_of(to_camera)]
    (folder / "calib.txt").write_text("\n".join(calibration) + "\n")
    return root


def kitti_labels(truth: dict[str, NDArray[np.generic]]) -> NDArray[np.uint32]:
    """Return raw ids; a movable point whose motion is unknown has none, as ids state motion."""
    if "semantic_raw" in truth:
        raw = truth["semantic_raw"].astype(np.uint32)
        of_object: NDArray[np.uint32] = truth["instance"].astype(np.uint32) * (1 << 16)
        return (raw + of_object).astype(np.uint32)
    table = np.array([_RAW_OF_19[n] for n in range(20)], np.uint32)
    raw = table[truth["semantic19"].astype(np.intp)]
    return np.where(truth["motion"] == 0, 0, raw).astype(np.uint32)


def time_line(stamp_ns: int) -> str:
    whole = datetime.fromtimestamp(stamp_ns // NS_PER_S, UTC)
    return f"{whole:%Y-%m-%d %H:%M:%S}.{stamp_ns % NS_PER_S:09d}"


def write_kitti_raw(
    root: Path, clouds: Sequence[DecodedCloud], poses: NDArray[np.float64], *, tracklets: str = ""
) -> Path:
    """Write one drive with oxts that lead to the given poses of the lidar."""
    day = root / "2011_09_26"
    folder = day / "2011_09_26_drive_0001_sync"
    for name in ("velodyne_points/data", "oxts/data"):
        (folder / name).mkdir(parents=True)
    times = []
    for number, cloud in enumerate(clouds):
        write_scan(folder / "velodyne_points" / "data" / f"{number:010d}.bin", cloud)
        oxts = oxts_line(poses[number] @ LIDAR_FROM_IMU)
        (folder / "oxts" / "data" / f"{number:010d}.txt").write_text(oxts)
        times.append(time_line(cloud.stamp_ns))
    (folder / "velodyne_points" / "timestamps.txt").write_text("\n".join(times) + "\n")
    rotation = " ".join(map(repr, LIDAR_FROM_IMU[:3, :3].ravel().tolist()))
    place = " ".join(map(repr, LIDAR_FROM_IMU[:3, 3].tolist()))
    calibration = f"calib_time: 25-May-2012 16:47:16\nR: {rotation}\nT: {place}\n"
    (day / "calib_imu_to_velo.txt").write_text(calibration)
    if tracklets:
        (folder / "tracklet_labels.xml").write_text(tracklets)
    return root


def oxts_line(world_from_imu: Transform, latitude: float = 49.0, longitude: float = 8.4) -> str:
    """Invert KITTI's Mercator, with an origin at a latitude and longitude."""
    scale = np.cos(np.radians(latitude))
    x0 = scale * EARTH_M * np.radians(longitude)
    y0 = scale * EARTH_M * np.log(np.tan(np.pi / 4 + np.radians(latitude) / 2))
    x, y, z = world_from_imu[:3, 3]
    east = np.degrees((x + x0) / (scale * EARTH_M))
    north = np.degrees(2 * (np.arctan(np.exp((y + y0) / (scale * EARTH_M))) - np.pi / 4))
    yaw, pitch, roll = Rotation.from_matrix(world_from_imu[:3, :3]).as_euler("ZYX")
    values = [north, east, z, roll, pitch, yaw, *([0.0] * 24)]
    return " ".join(repr(float(each)) for each in values)


def write_kitti360(root: Path, clouds: Sequence[DecodedCloud], poses: NDArray[np.float64]) -> Path:
    """Write one drive with poses of the car, whose mounting follows from camera 0."""
    drive = "2013_05_28_drive_0000_sync"
    folder = root / "data_3d_raw" / drive / "velodyne_points"
    (folder / "data").mkdir(parents=True)
    calibration, of_poses = root / "calibration", root / "data_poses" / drive
    calibration.mkdir()
    of_poses.mkdir(parents=True)
    lidar_from_camera = inverse(camera_from_lidar())
    car_from_camera = np.eye(4)
    car_from_camera[:3, 3] = (1.5, 0.3, 0.9)
    mounting = car_from_camera @ np.linalg.inv(lidar_from_camera)
    times, rows = [], []
    for number, cloud in enumerate(clouds):
        write_scan(folder / "data" / f"{number:010d}.bin", cloud)
        times.append(time_line(cloud.stamp_ns))
        rows.append(f"{number} " + row_of(poses[number] @ np.linalg.inv(mounting)))
    (folder / "timestamps.txt").write_text("\n".join(times) + "\n")
    (of_poses / "poses.txt").write_text("\n".join(rows) + "\n")
    (calibration / "calib_cam_to_velo.txt").write_text(row_of(lidar_from_camera) + "\n")
    cameras = [f"image_0{n}: " + row_of(car_from_camera) for n in range(4)]
    (calibration / "calib_cam_to_pose.txt").write_text("\n".join(cameras) + "\n")
    return root
