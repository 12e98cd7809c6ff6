"""Format `nuscenes-lidarseg`: a folder for each scene that the nuScenes devkit opens.

Its version is `v1.0-counterpoint`. Every frame is a key frame of the sensor LIDAR_TOP. Classes are
those of nuScenes-lidarseg, which do not name motion; points without a class are `noise`, as there.
"""

import hashlib
import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from service.export.format import Format
from service.export.frames_file import (
    digest_of,
    frame_of,
    pose_from_first,
    write_frames,
    write_index,
)
from service.export.points import LabelledCloud
from service.export.rotation import quaternion_wxyz
from service.export.scene import SceneToExport

VERSION: Final = "v1.0-counterpoint"
CHANNEL: Final = "LIDAR_TOP"

CLASSES: Final = (
    *("noise", "animal", "human.pedestrian.adult", "human.pedestrian.child"),
    *("human.pedestrian.construction_worker", "human.pedestrian.personal_mobility"),
    *("human.pedestrian.police_officer", "human.pedestrian.stroller"),
    *("human.pedestrian.wheelchair", "movable_object.barrier", "movable_object.debris"),
    *("movable_object.pushable_pullable", "movable_object.trafficcone"),
    *("static_object.bicycle_rack", "vehicle.bicycle", "vehicle.bus.bendy"),
    *("vehicle.bus.rigid", "vehicle.car", "vehicle.construction"),
    *("vehicle.emergency.ambulance", "vehicle.emergency.police", "vehicle.motorcycle"),
    *("vehicle.trailer", "vehicle.truck", "flat.driveable_surface", "flat.other"),
    *("flat.sidewalk", "flat.terrain", "static.manmade", "static.other", "static.vegetation"),
    "vehicle.ego",
)
"""Classes of nuScenes-lidarseg by their index."""

_OF_SEMANTICKITTI: Final = {
    **dict.fromkeys((10, 252, 20, 259), "vehicle.car"),
    **dict.fromkeys((11, 31, 253), "vehicle.bicycle"),
    **dict.fromkeys((15, 32, 255), "vehicle.motorcycle"),
    **dict.fromkeys((13, 257, 16, 256), "vehicle.bus.rigid"),
    **dict.fromkeys((18, 258), "vehicle.truck"),
    **dict.fromkeys((30, 254), "human.pedestrian.adult"),
    **dict.fromkeys((40, 44, 60), "flat.driveable_surface"),
    48: "flat.sidewalk",
    49: "flat.other",
    72: "flat.terrain",
    **dict.fromkeys((50, 51, 52, 80, 81), "static.manmade"),
    99: "static.other",
    **dict.fromkeys((70, 71), "static.vegetation"),
}
"""Class of nuScenes for the pre-labels of SemanticKITTI; vehicles of no other class are cars."""

_PIXEL: Final = bytes.fromhex(
    "89504e470d0a1a0a0000000d49484452000000010000000108000000003a7e9b55"
    "0000000a49444154789c63600000000200014873afa40000000049454e44ae426082"
)
"""A PNG of one pixel: the devkit needs a map for each log."""


def write_scene(scene: SceneToExport, folder: Path) -> None:
    """Write the tables and files of one scene.

    Raises:
        PermanentError: If the log is gone, or no longer has the frames.
    """
    for name in (f"samples/{CHANNEL}", f"lidarseg/{VERSION}", VERSION, "maps"):
        (folder / name).mkdir(parents=True)
    (folder / "maps" / "none.png").write_bytes(_PIXEL)
    lookup = np.zeros(2**16, dtype=np.uint8)
    for number, name in _OF_SEMANTICKITTI.items():
        lookup[number] = CLASSES.index(name)
    tables = _Tables(scene)
    frames: list[dict[str, Any]] = []
    for cloud in scene.clouds():
        file, token = tables.add(cloud)
        points = np.column_stack([cloud.points_m, cloud.intensity * 255, cloud.ring])
        points.astype("<f4").tofile(folder / file)
        classes = lookup[cloud.label]
        classes.tofile(folder / tables.label_file(token))
        write_index(cloud, folder)
        frames.append(frame_of(cloud, scene) | {"pre_labels": digest_of(classes)})
    for name, rows in tables.finished().items():
        (folder / VERSION / f"{name}.json").write_text(json.dumps(rows, indent=1) + "\n")
    write_frames(scene, frames, folder)


class _Tables:
    """Tables of one scene; tokens are digests, so that a second export has the same."""

    def __init__(self, scene: SceneToExport) -> None:
        self._scene = scene
        self._first: LabelledCloud | None = None
        self._samples: list[dict[str, Any]] = []
        self._data: list[dict[str, Any]] = []
        self._poses: list[dict[str, Any]] = []

    def add(self, cloud: LabelledCloud) -> tuple[str, str]:
        """Add a frame; return the path of its cloud, and the token of its data."""
        self._first = self._first or cloud
        stamp_us = cloud.stamp_ns // 1000
        file = f"samples/{CHANNEL}/{self._scene.stem}__{CHANNEL}__{stamp_us}.pcd.bin"
        sample, data, placed = (
            self._token(f"{name}/{cloud.number}") for name in ("sample", "data", "pose")
        )
        pose = pose_from_first(cloud, self._first)
        self._poses.append(
            {
                "token": placed,
                "timestamp": stamp_us,
                "rotation": list(quaternion_wxyz(pose[:3, :3])),
                "translation": pose[:3, 3].tolist(),
            }
        )
        self._samples.append(
            {"token": sample, "timestamp": stamp_us, "scene_token": self._token("scene")}
        )
        self._data.append(
            {
                "token": data,
                "sample_token": sample,
                "ego_pose_token": placed,
                "calibrated_sensor_token": self._token("calibrated"),
                "timestamp": stamp_us,
                "fileformat": "pcd",
                "is_key_frame": True,
                "height": 0,
                "width": 0,
                "filename": file,
            }
        )
        return file, data

    def label_file(self, token: str) -> str:
        """Return the path of the labels of a cloud."""
        return f"lidarseg/{VERSION}/{token}_lidarseg.bin"

    def finished(self) -> dict[str, list[dict[str, Any]]]:
        """Return all tables by name."""
        score, scene, log = self._scene.score, self._token("scene"), self._token("log")
        identity = {"rotation": [1.0, 0.0, 0.0, 0.0], "translation": [0.0, 0.0, 0.0]}
        headline = score.reasons[0].headline if score.reasons else ""
        described = {
            "token": scene,
            "name": self._scene.stem,
            "description": headline,
            "log_token": log,
            "nbr_samples": len(self._samples),
            "first_sample_token": self._samples[0]["token"],
            "last_sample_token": self._samples[-1]["token"],
        }
        driven = {
            "token": log,
            "logfile": score.log_id,
            "vehicle": score.vehicle,
            "date_captured": score.date,
            "location": "unknown",
        }
        calibrated = {"token": self._token("calibrated"), "sensor_token": self._token("sensor")}
        return {
            "category": [
                {"token": self._token(name), "name": name, "description": "", "index": index}
                for index, name in enumerate(CLASSES)
            ],
            "attribute": [],
            "visibility": [],
            "instance": [],
            "sample_annotation": [],
            "sensor": [{"token": self._token("sensor"), "channel": CHANNEL, "modality": "lidar"}],
            "calibrated_sensor": [{**calibrated, **identity, "camera_intrinsic": []}],
            "ego_pose": self._poses,
            "log": [driven],
            "map": [
                {
                    "token": self._token("map"),
                    "log_tokens": [log],
                    "category": "semantic_prior",
                    "filename": "maps/none.png",
                }
            ],
            "scene": [described],
            "sample": _chained(self._samples),
            "sample_data": _chained(self._data),
            "lidarseg": [
                {
                    "token": each["token"],
                    "sample_data_token": each["token"],
                    "filename": self.label_file(each["token"]),
                }
                for each in self._data
            ],
        }

    def _token(self, name: str) -> str:
        text = f"{self._scene.score.scene_id} {name}"
        return hashlib.sha256(text.encode()).hexdigest()[:32]


def _chained(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Link each row to its neighbours in time."""
    tokens = ["", *(row["token"] for row in rows), ""]
    return [
        {**row, "prev": tokens[number], "next": tokens[number + 2]}
        for number, row in enumerate(rows)
    ]


NUSCENES: Final = Format(
    name="nuscenes-lidarseg",
    text="A folder for each scene that the nuScenes devkit opens, with lidarseg pre-labels.",
    write_scene=write_scene,
    reads_logs=True,
)
"""Motion is not part of its classes."""
