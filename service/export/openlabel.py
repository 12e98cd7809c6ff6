"""Format `openlabel`: the boxes of each scene's contradictions as ASAM OpenLABEL 1.0.0.

Each track is an object, each of its instances a cuboid in the lidar's space of its frame. Frames
have their poses as transforms to the space `odom`. No log is read.
"""

import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from schemas.arrays import NS_PER_S
from schemas.contradiction import TrackRecord
from service.export.format import Format
from service.export.scene import SceneToExport

SCHEMA_VERSION: Final = "1.0.0"
_LIDAR: Final = "lidar"
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
    for number in range(len(overlay)):
        objects: dict[str, Any] = {}
        for instance in overlay.instances_of(number).tolist():
            track_id = int(overlay.instance_track[instance])
            seen.setdefault(track_id, []).append(number)
            cuboid = _cuboid(overlay.instance_boxes[instance], len(objects))
            known = objects.setdefault(str(track_id), {"object_data": {"cuboid": []}})
            known["object_data"]["cuboid"].append(cuboid)
        frames[str(number)] = {
            "frame_properties": {
                "timestamp": f"{int(overlay.stamps_ns[number]) / NS_PER_S:.9f}",
                "transforms": {
                    "odom_from_lidar": {
                        "src": _LIDAR,
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
                _ODOM: {"type": "scene_cs", "parent": "", "children": [_LIDAR]},
                _LIDAR: {"type": "sensor_cs", "parent": _ODOM, "children": []},
            },
            "streams": {_LIDAR: {"type": "lidar", "description": score.lidar_topic}},
            "frame_intervals": [{"frame_start": 0, "frame_end": len(overlay) - 1}],
            "frames": frames,
            "objects": {
                str(track_id): _object(track_id, tracks.get(track_id), numbers)
                for track_id, numbers in sorted(seen.items())
            },
        }
    }


def _object(track_id: int, track: TrackRecord | None, frames: list[int]) -> dict[str, Any]:
    """Describe a track; those beyond the record have a box and no more."""
    made: dict[str, Any] = {
        "name": f"track-{track_id}",
        "type": (track.class_name if track else "") or "object",
        "coordinate_system": _LIDAR,
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


def _cuboid(box: Any, number: int) -> dict[str, Any]:
    """Return a box as centre, quaternion (x, y, z, w) and size."""
    x, y, z, length, width, height, yaw = map(float, box)
    turned = [0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))]
    return {
        "name": f"box-{number}",
        "val": [x, y, z, *turned, length, width, height],
        "coordinate_system": _LIDAR,
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
