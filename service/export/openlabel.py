"""Format `openlabel`: the boxes of each scene's contradictions as ASAM OpenLABEL 1.0.0.

Each track is an object, each of its instances a cuboid in the lidar's space of its frame. The
attribute `moving` of a cuboid is its pre-label. Frames have their poses as transforms to the space
`odom`. No log is read.
"""

import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from schemas.arrays import NS_PER_S
from schemas.contradiction import TrackRecord
from schemas.overlay import Overlay
from service.export.classes import MOVING_ATTRIBUTE
from service.export.format import Format
from service.export.points import PointLabels
from service.export.scene import SceneToExport

SCHEMA_VERSION: Final = "1.0.0"
LIDAR: Final = "lidar"

_ODOM: Final = "odom"


def write_scene(scene: SceneToExport, path: Path) -> None:
    """Write the document of one scene."""
    path.write_text(json.dumps(document(scene), indent=1) + "\n", encoding="utf-8")


def document(scene: SceneToExport) -> dict[str, Any]:
    """Return the document of one scene."""
    overlay, score = scene.overlay, scene.score
    tracks = {track.track_id: track for track in score.tracks}
    frames: dict[str, Any] = {}
    seen: dict[int, list[int]] = {}
    for number, objects in enumerate(objects_of_frames(overlay, scene.labels)):
        for name in objects:
            seen.setdefault(int(name), []).append(number)
        frames[str(number)] = {
            "frame_properties": {
                "timestamp": f"{int(overlay.stamps_ns[number]) / NS_PER_S:.9f}",
                "transforms": {
                    "odom_from_lidar": {
                        "src": LIDAR,
                        "dst": _ODOM,
                        "transform_src_to_dst": {
                            "matrix4x4": overlay.odom_from_sensor[number].reshape(-1).tolist()
                        },
                    }
                },
            },
            "objects": objects,
        }
    return {
        "openlabel": {
            "metadata": {
                "schema_version": SCHEMA_VERSION,
                "name": score.scene_id,
                "comment": score.reasons[0].headline if score.reasons else "",
                "tagged_file": score.log_id,
                "counterpoint": {
                    "record_sha256": scene.sha256,
                    "score": score.score,
                    "verdicts": [each.model_dump() for each in scene.verdicts],
                },
            },
            "coordinate_systems": {
                _ODOM: {"type": "scene_cs", "parent": "", "children": [LIDAR]},
                LIDAR: {"type": "sensor_cs", "parent": _ODOM, "children": []},
            },
            "streams": {LIDAR: {"type": "lidar", "description": score.lidar_topic}},
            "frame_intervals": [{"frame_start": 0, "frame_end": len(overlay) - 1}],
            "frames": frames,
            "objects": {
                str(track_id): _object(track_id, tracks.get(track_id), numbers)
                for track_id, numbers in sorted(seen.items())
            },
        }
    }


def objects_of_frames(overlay: Overlay, labels: PointLabels) -> list[dict[str, Any]]:
    """Return for each frame its objects by track, each with its cuboids."""
    moving = labels.moving_instances
    frames: list[dict[str, Any]] = []
    for number in range(len(overlay)):
        objects: dict[str, Any] = {}
        for instance in overlay.instances_of(number).tolist():
            name = str(int(overlay.instance_track[instance]))
            box, moves = overlay.instance_boxes[instance], bool(moving[instance])
            cuboid = _cuboid(box, len(objects), moving=moves)
            known = objects.setdefault(name, {"object_data": {"cuboid": []}})
            known["object_data"]["cuboid"].append(cuboid)
        frames.append(objects)
    return frames


def type_of(track: TrackRecord | None) -> str:
    """Return the type of the object of a track; one beyond the record is `object`."""
    return (track.class_name if track else "") or "object"


def _object(track_id: int, track: TrackRecord | None, frames: list[int]) -> dict[str, Any]:
    """Describe a track; those beyond the record have a box and no more."""
    made: dict[str, Any] = {
        "name": f"track-{track_id}",
        "type": type_of(track),
        "coordinate_system": LIDAR,
        "frame_intervals": _intervals(frames),
    }
    if track is not None:
        blamed = track.attribution
        texts = {"kind": track.kind, "wrong": blamed.wrong.value if blamed else ""}
        numbers = {"strength": track.strength, "speed_m_per_s": track.speed_m_per_s}
        made["object_data"] = {
            "text": [{"name": name, "val": value} for name, value in texts.items()],
            "num": [{"name": name, "val": value} for name, value in numbers.items()],
        }
    return made


def _cuboid(box: Any, number: int, *, moving: bool) -> dict[str, Any]:
    """Return a box as centre, quaternion (x, y, z, w) and size."""
    x, y, z, length, width, height, yaw = map(float, box)
    turned = [0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))]
    return {
        "name": f"box-{number}",
        "val": [x, y, z, *turned, length, width, height],
        "coordinate_system": LIDAR,
        "attributes": {"boolean": [{"name": MOVING_ATTRIBUTE, "val": moving}]},
    }


def _intervals(frames: list[int]) -> list[dict[str, int]]:
    """Return the stretches of consecutive frames."""
    numbers = sorted(set(frames))
    stretches: list[dict[str, int]] = []
    for number in numbers:
        if stretches and number == stretches[-1]["frame_end"] + 1:
            stretches[-1]["frame_end"] = number
        else:
            stretches.append({"frame_start": number, "frame_end": number})
    return stretches


OPENLABEL: Final = Format(
    name="openlabel",
    text="ASAM OpenLABEL 1.0.0: a cuboid for each contradiction, by track; no log is read.",
    ending=".openlabel.json",
    write_scene=write_scene,
)
"""Read by Kognic and others."""
