"""Frames of an exported scene as JSON: the way back from exported points to those of the log."""

import json
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from service.export.points import LabelledCloud
from service.export.scene import SceneToExport

NAME: Final = "frames.json"
INDEX: Final = "index"
"""Folder with a file for each frame: uint32, the place in the raw message of each point."""


def write_index(cloud: LabelledCloud, folder: Path) -> None:
    """Write the places of a frame's points in the raw message."""
    (folder / INDEX).mkdir(exist_ok=True)
    cloud.raw_index.astype("<u4").tofile(folder / INDEX / f"{cloud.number:06d}.bin")


def digest_of(words: NDArray[np.unsignedinteger]) -> str:
    """Digest the classes of the labels of a frame, in the order of its exported points."""
    return sha256((words.astype("<u4") & 0xFFFF).astype("<u2").tobytes()).hexdigest()[:16]


def digest_of_json(content: Any) -> str:
    """Digest what a file states about a frame, whatever the order of its keys."""
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def frame_of(cloud: LabelledCloud, scene: SceneToExport) -> dict[str, Any]:
    """Describe a frame, by the names that a folder of truth gives its frames.

    `lidars` names the further lidars of a joined frame: the message of each, and the place of its
    first point after those of the messages before.
    """
    first, further = cloud.raw_points - sum(each.points for each in cloud.lidars), []
    for lidar in cloud.lidars:
        further.append(
            {
                "topic": lidar.topic,
                "header_stamp": lidar.stamp_ns,
                "first": first,
                "points": lidar.points,
            }
        )
        first += lidar.points
    return ({"lidars": further} if further else {}) | {
        "index": cloud.number,
        "topic": scene.score.lidar_topic,
        "header_stamp": cloud.stamp_ns,
        "points": len(cloud),
        "raw_points": cloud.raw_points,
        "pre_labels": digest_of(cloud.label),
    }


def write_frames(scene: SceneToExport, frames: Sequence[dict[str, Any]], folder: Path) -> None:
    """Write what identifies the scene, its frames, its tracks and the verdicts on them."""
    score = scene.score
    tracks = [
        {
            "track_id": track.track_id,
            "instance": track.track_id + 1,
            "kind": track.kind,
            "class_name": track.class_name,
            "strength": track.strength,
            "wrong": track.attribution.wrong.value if track.attribution else None,
        }
        for track in score.tracks
    ]
    whole = {
        "scene_id": score.scene_id,
        "log_id": score.log_id,
        "lidar_topic": score.lidar_topic,
        "record_sha256": scene.sha256,
        "score": score.score,
        "frames": list(frames),
        "tracks": tracks,
        "verdicts": [each.model_dump() for each in scene.verdicts],
    }
    (folder / NAME).write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")


def pose_from_first(cloud: LabelledCloud, first: LabelledCloud) -> np.ndarray[Any, Any]:
    """Return the (4, 4) pose of a frame in the sensor space of the first one."""
    posed: np.ndarray[Any, Any] = np.linalg.inv(first.odom_from_sensor) @ cloud.odom_from_sensor
    return posed
