"""Small made-up folders of nuScenes, ONCE and SemanticKITTI: a car that drives past parked ones."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from schemas.arrays import Transform
from tests.dataset_folders.kitti import camera_from_lidar, row_of
from tests.dataset_folders.real_logs import wxyz

STEP_S = 0.05
KEYFRAME_EVERY = 10
MOVER_M_PER_S = 4.0
START_US = 1_532_402_927_600_000


def cloud(mover_x: float, parked_x: float = 8.0) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return (N, 3) points, x ahead, and a kind each: 0 ground, 1 parked car, 2 moving car."""
    grid = np.mgrid[-20:20:40j, -20:20:40j].reshape(2, -1).T
    ground = np.column_stack([grid, np.full(len(grid), -1.8)])
    body = np.mgrid[-1.8:1.8:12j, -0.8:0.8:6j, -0.6:0.6:5j].reshape(3, -1).T
    parked = body + np.array([parked_x, 5.0, -1.0])
    moving = body + np.array([mover_x, -5.0, -1.0])
    points = np.concatenate([ground, parked, moving]).astype(np.float32)
    kinds = np.repeat([0, 1, 2], [len(ground), len(parked), len(moving)]).astype(np.uint8)
    return points, kinds


def image(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (64, 48)).save(path)


def car_pose(number: int) -> Transform:
    """Return the pose of the car in the world; it drives ahead at 2 m/s."""
    pose: Transform = np.eye(4)
    pose[0, 3] = 100.0 + 2.0 * STEP_S * number
    return pose


MOUNTED: Transform = np.array(
    [[0.0, 1.0, 0.0, 0.9], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.8], [0.0, 0.0, 0.0, 1.0]]
)
"""The lidar of nuScenes on the car: its y axis is ahead."""


def write_nuscenes(root: Path, *, sweeps: int = 31, lidarseg: bool = True) -> Path:
    """Write one scene of `v1.0-mini` with keyframes at 2 Hz among sweeps at 20 Hz."""
    tables: dict[str, list[dict[str, Any]]] = {
        "log": [{"token": "log", "vehicle": "n008", "date_captured": "2018-07-24"}],
        "scene": [{"token": "scene", "name": "scene-0001", "log_token": "log"}],
        "category": [
            {"token": "car", "name": "vehicle.car"},
        ],
        "instance": [{"token": name, "category_token": "car"} for name in ("parked", "mover")],
        "calibrated_sensor": [
            _calibrated("lidar", MOUNTED),
            _calibrated("camera", np.eye(4), [[50.0, 0, 32], [0, 50.0, 24], [0, 0, 1]]),
        ],
        "sample": [],
        "sample_data": [],
        "ego_pose": [],
        "sample_annotation": [],
        "lidarseg": [],
    }
    to_own = np.linalg.inv(MOUNTED[:3, :3])
    for number in range(sweeps):
        is_key = number % KEYFRAME_EVERY == 0
        sample = f"sample-{number // KEYFRAME_EVERY}"
        if is_key:
            tables["sample"].append({"token": sample, "scene_token": "scene"})
        at_us = START_US + round(number * STEP_S * 1e6)
        folder = "samples" if is_key else "sweeps"
        name = f"{folder}/LIDAR_TOP/{at_us}.pcd.bin"
        pose = car_pose(number)
        mover = -5.0 + (MOVER_M_PER_S - 2.0) * STEP_S * number
        parked = 8.0 - 2.0 * STEP_S * number
        ahead, kinds = cloud(mover, parked)
        own = ahead.astype(np.float64) @ to_own.T
        rows = np.zeros((len(own), 5), np.float32)
        rows[:, :3], rows[:, 3], rows[:, 4] = own, 12.0, np.arange(len(own)) % 32
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(rows.tobytes())
        tables["ego_pose"].append(_placed(f"pose-{number}", pose))
        tables["sample_data"].append(_data(f"lidar-{number}", sample, name, at_us, number, is_key))
        if is_key:
            picture = f"samples/CAM_FRONT/{at_us}.jpg"
            image(root / picture)
            row = _data(f"camera-{number}", sample, picture, at_us, number, True)
            row |= {"calibrated_sensor_token": "camera", "width": 64, "height": 48}
            tables["sample_data"].append(row)
            for who, place in (("parked", (parked, 5.0)), ("mover", (mover, -5.0))):
                box = np.eye(4)
                box[:3, 3] = (*place, -1.0)
                world = pose @ _level(MOUNTED) @ box
                row = _placed(f"{who}-{number}", world)
                row |= {"sample_token": sample, "instance_token": who, "size": [1.8, 3.8, 1.4]}
                tables["sample_annotation"].append(row)
            if lidarseg:
                file = f"lidarseg/v1.0-mini/lidar-{number}_lidarseg.bin"
                (root / file).parent.mkdir(parents=True, exist_ok=True)
                (root / file).write_bytes(np.array([24, 17, 17], np.uint8)[kinds].tobytes())
                tables["lidarseg"].append(
                    {"token": file, "sample_data_token": f"lidar-{number}", "filename": file}
                )
    version = root / "v1.0-mini"
    version.mkdir()
    for table, content in tables.items():
        if content or table != "lidarseg":
            (version / f"{table}.json").write_text(json.dumps(content, indent=0))
    return root


def _level(pose: Transform) -> Transform:
    """Return the place of the lidar with the axes of the car, x ahead."""
    level: Transform = np.eye(4)
    level[:3, 3] = pose[:3, 3]
    return level


def _placed(token: str, pose: Transform) -> dict[str, Any]:
    return {"token": token, "translation": pose[:3, 3].tolist(), "rotation": wxyz(pose)}


def _calibrated(token: str, pose: Transform, intrinsic: Any = ()) -> dict[str, Any]:
    return {**_placed(token, pose), "camera_intrinsic": list(intrinsic)}


def _data(
    token: str, sample: str, name: str, at_us: int, number: int, is_key: bool
) -> dict[str, Any]:
    return {
        "token": token,
        "sample_token": sample,
        "filename": name,
        "timestamp": at_us,
        "is_key_frame": is_key,
        "ego_pose_token": f"pose-{number}",
        "calibrated_sensor_token": "lidar",
    }


def write_once(root: Path, *, frames: int = 4) -> Path:
    """Write one sequence at 2 Hz, every second frame with boxes; its axes are x left, y back."""
    folder = root / "data" / "000027"
    (folder / "lidar_roof").mkdir(parents=True)
    listed = []
    for number in range(frames):
        name = str(1_616_343_527_200 + 500 * number)
        ahead, _ = cloud(-5.0)
        rows = np.zeros((len(ahead), 4), np.float32)
        rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = ahead[:, 1], -ahead[:, 0], ahead[:, 2], 7.0
        (folder / "lidar_roof" / f"{name}.bin").write_bytes(rows.tobytes())
        image(folder / "cam01" / f"{name}.jpg")
        stated: dict[str, Any] = {"frame_id": name, "pose": [0, 0, 0, 1, 0.0, -1.0 * number, 0.0]}
        if number % 2 == 0:
            # the parked car, at (8, 5) ahead and left
            box = [5.0, -8.0, -1.0, 3.8, 1.8, 1.4, np.pi / 2]
            stated["annos"] = {"names": ["Car"], "boxes_3d": [box]}
        listed.append(stated)
    calibration = {
        "cam01": {
            "cam_to_velo": np.eye(4).tolist(),
            "cam_intrinsic": [[50, 0, 32], [0, 50, 24], [0, 0, 1]],
            "distortion": [0.1, 0, 0, 0, 0],
        }
    }
    content = {"meta_info": {}, "calib": calibration, "frames": listed}
    (folder / "000027.json").write_text(json.dumps(content))
    return root


def write_small_kitti(root: Path, *, frames: int = 3, points: int = 0) -> Path:
    """Write a sequence 08 of made-up scans with labels, an image each, poses and times."""
    folder = root / "dataset" / "sequences" / "08"
    for name in ("velodyne", "labels"):
        (folder / name).mkdir(parents=True)
    to_camera = camera_from_lidar()
    poses = []
    for number in range(frames):
        ahead, kinds = cloud(-5.0 + 0.4 * number)
        if points:
            ahead, kinds = ahead[:points], kinds[:points]
        rows = np.zeros((len(ahead), 4), np.float32)
        rows[:, :3], rows[:, 3] = ahead, 0.5
        (folder / "velodyne" / f"{number:06d}.bin").write_bytes(rows.tobytes())
        labels = np.array([40, 10 | 3 << 16, 252 | 5 << 16], "<u4")[kinds]
        (folder / "labels" / f"{number:06d}.label").write_bytes(labels.tobytes())
        lidar = np.eye(4)
        lidar[0, 3] = 0.2 * number
        poses.append(row_of(to_camera @ lidar @ np.linalg.inv(to_camera)))
        image(folder / "image_2" / f"{number:06d}.png")
    (folder / "poses.txt").write_text("\n".join(poses) + "\n")
    (folder / "times.txt").write_text("\n".join(f"{0.1 * n:e}" for n in range(frames)) + "\n")
    projection = np.array([[700.0, 0, 32, 40.0], [0, 700.0, 24, 0.2], [0, 0, 1, 0.003]])
    p2 = " ".join(map(str, projection.ravel()))
    (folder / "calib.txt").write_text(f"P2: {p2}\nTr: {row_of(to_camera)}\n")
    return root
