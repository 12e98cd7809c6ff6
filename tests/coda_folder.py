"""Writes a small folder in CODA's form: four images, twelve annotations, made-up clouds."""

import json
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

IMAGE_PX: Final = (1920, 1020)
FOCAL_PX: Final = 1000.0
NAMES: Final = ("kitti_000003.jpg", "nuscenes_000007.jpg", "000004.jpg", "kitti_000010.jpg")
CATEGORIES: Final = (("car", "vehicle"), ("pedestrian", "pedestrian"), ("dog", "animal"))
OBJECTS_M: Final = ((12.0, 3.0), (15.0, -4.0), (20.0, 1.0))
"""Forward and left distance of the three objects of each image, metres."""

PUBLISHED_GRADES: Final = (3, 1, 2, 4, 5, 6, 7, 8, 9, 1, 3, 3)

_CAMERA_FROM_KITTI: Final = np.array(
    [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], np.float64
)


def write_coda(folder: Path) -> None:
    """Write annotations, clouds and calibrations; image ids are 3, 7, 4 and 10."""
    ids = (3, 7, 4, 10)
    (folder / "lidar").mkdir(parents=True)
    (folder / "calib").mkdir()
    annotations = []
    for place, (image_id, name) in enumerate(zip(ids, NAMES, strict=True)):
        cloud = _cloud(seed=place)
        native, lidar_from_kitti = _native(cloud, name)
        columns = 5 if name.startswith("nuscenes") else 4
        rows = np.zeros((len(native), columns), np.float32)
        rows[:, :3] = native
        (folder / "lidar" / f"{image_id:04d}.bin").write_bytes(rows.tobytes())
        _write_calibration(folder / "calib", image_id, name, lidar_from_kitti)
        annotations += [
            {"id": 3 * place + box + 1, "image_id": image_id, "category_id": box, "bbox": bbox}
            for box, bbox in enumerate(_boxes())
        ]
    content = {
        "images": [
            {"id": number, "file_name": name} for number, name in zip(ids, NAMES, strict=True)
        ],
        "annotations": annotations,
        "categories": [
            {"id": number, "name": name, "supercategory": above}
            for number, (name, above) in enumerate(CATEGORIES)
        ],
    }
    (folder / "corner_case.json").write_text(json.dumps(content))
    (folder / "annotation_validation").write_text("\n".join(map(str, PUBLISHED_GRADES)))


def _cloud(seed: int) -> NDArray[np.float64]:
    """Three objects of 40 points and a wall behind them, in KITTI's axes, metres."""
    random = np.random.default_rng(seed)
    objects = [
        random.normal((forward, left, 0.0), (0.05, 0.1, 0.1), (40, 3))
        for forward, left in OBJECTS_M
    ]
    wall = np.column_stack(
        (np.full(300, 30.0), random.uniform(-12, 12, 300), random.uniform(-1, 2, 300))
    )
    return np.vstack((*objects, wall))


def _native(
    cloud: NDArray[np.float64], name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Turn KITTI's axes to those of the image's data set; also the matrix of that turn."""
    turn = np.eye(4)
    if name.startswith("nuscenes"):
        turn[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    elif not name.startswith("kitti"):
        turn[:3, :3] = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    return cloud @ turn[:3, :3].T, turn


def _write_calibration(
    folder: Path, image_id: int, name: str, lidar_from_kitti: NDArray[np.float64]
) -> None:
    width, height = IMAGE_PX
    intrinsic = np.array([[FOCAL_PX, 0, width / 2], [0, FOCAL_PX, height / 2], [0, 0, 1]])
    camera_from_lidar = _CAMERA_FROM_KITTI @ np.linalg.inv(lidar_from_kitti)
    lidar_from_camera = np.linalg.inv(camera_from_lidar)
    if name.startswith("kitti"):
        rows = {
            "P2": np.column_stack((intrinsic, np.zeros(3))),
            "R0_rect": np.eye(3),
            "Tr_velo_to_cam": camera_from_lidar[:3],
        }
        lines = [f"{key}: {' '.join(map(str, value.ravel()))}" for key, value in rows.items()]
        (folder / f"{image_id:04d}.txt").write_text("\n".join(lines))
        return
    eye = np.eye(4).tolist()
    content = (
        {
            "ego_from_lidar": eye,
            "global_from_ego_at_lidar": eye,
            "global_from_ego_at_camera": eye,
            "ego_from_camera": lidar_from_camera.tolist(),
            "camera_intrinsic": intrinsic.tolist(),
        }
        if name.startswith("nuscenes")
        else {
            "cam_to_velo": lidar_from_camera.tolist(),
            "cam_intrinsic": intrinsic.tolist(),
            "distortion": [-0.1, 0.02, 0.0, 0.0, 0.0],
        }
    )
    (folder / f"{image_id:04d}.json").write_text(json.dumps(content))


def _boxes() -> list[list[float]]:
    """Boxes of 200 pixels around the three objects, and a part of the wall behind them."""
    return [
        [
            IMAGE_PX[0] / 2 - FOCAL_PX * left / forward - 100,
            IMAGE_PX[1] / 2 - 100,
            200.0,
            200.0,
        ]
        for forward, left in OBJECTS_M
    ]
