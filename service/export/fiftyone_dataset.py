"""Format `fiftyone`: a dataset of FiftyOne on disk, a 3D sample for each frame.

The layout is the one that its importer reads without a database document: `metadata.json`,
`samples.json`, and media with paths relative to the folder. `fiftyone.types.FiftyOneDataset` opens
it. Contradictions are 3D detections in the lidar's space.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from schemas.arrays import NS_PER_S
from service.curation.selection import Selection
from service.export.classes import MOVING_ATTRIBUTE
from service.export.format import Format
from service.export.frames_file import digest_of_json, frame_of, write_frames, write_index
from service.export.pcd import pcd
from service.export.scene import SceneToExport

DATA: Final = "data"
SAMPLES: Final = "samples.json"

MEDIA_TYPE: Final = "3d"
FO3D_VERSION: Final = "1.0"

_PLACED: Final = {"visible": True, "position": [0.0] * 3, "quaternion": [0.0, 0.0, 0.0, 1.0]}
_NODE: Final = {**_PLACED, "scale": [1.0, 1.0, 1.0]}


def write_scene(scene: SceneToExport, folder: Path) -> None:
    """Write the point clouds of one scene, each with the 3D scene that shows it.

    Raises:
        PermanentError: If the log is gone, or no longer has the frames.
    """
    folder.mkdir(parents=True)
    frames: list[dict[str, Any]] = []
    for cloud in scene.clouds():
        name = f"{cloud.number:06d}"
        (folder / f"{name}.pcd").write_bytes(pcd(cloud))
        (folder / f"{name}.fo3d").write_text(json.dumps(shown(f"{name}.pcd")) + "\n")
        write_index(cloud, folder)
        pre_labels = digest_of_detections(_detections(scene, cloud.number))
        frames.append(frame_of(cloud, scene) | {"pre_labels": pre_labels})
    write_frames(scene, frames, folder)


def shown(points: str) -> dict[str, Any]:
    """Return the 3D scene of a frame: its point cloud, coloured by height, z up."""
    material = {
        "_type": "PointCloudMaterial",
        "opacity": 1.0,
        "shadingMode": "height",
        "customColor": "#ffffff",
        "pointSize": 1.0,
        "attenuateByDistance": False,
    }
    cloud = {
        "_type": "PointCloud",
        "name": "points",
        **_NODE,
        "children": [],
        "centerGeometry": False,
        "pcdPath": points,
        "defaultMaterial": material,
        "flagForProjection": True,
    }
    camera = {"position": None, "lookAt": None, "aspect": None, "up": "Z", "fov": 50.0}
    return {
        "_type": "Scene",
        "name": "Scene",
        **_NODE,
        "children": [cloud],
        "__FO3D_VERSION": FO3D_VERSION,
        "camera": {**camera, "near": 0.1, "far": 2000.0},
        "lights": None,
        "background": None,
    }


def write_samples(selection: Selection, scenes: Sequence[SceneToExport], folder: Path) -> None:
    """Write the samples of all scenes, and what describes the dataset."""
    samples = [sample for scene in scenes for sample in samples_of(scene)]
    _write(folder / SAMPLES, {"samples": samples})
    info = {"selection": selection.name, "strategy": selection.strategy, "scenes": len(scenes)}
    about = {"name": selection.name, "media_type": MEDIA_TYPE, "info": info}
    _write(folder / "metadata.json", about)


def samples_of(scene: SceneToExport) -> Iterator[dict[str, Any]]:
    """Yield the sample of each frame of a scene."""
    score, overlay = scene.score, scene.overlay
    for number in range(len(overlay)):
        yield {
            "_media_type": MEDIA_TYPE,
            "filepath": f"{DATA}/{scene.stem}/{number:06d}.fo3d",
            "tags": [],
            "metadata": None,
            "scene_id": score.scene_id,
            "record_sha256": scene.sha256,
            "frame": number,
            "stamp_s": int(overlay.stamps_ns[number]) / NS_PER_S,
            "log_id": score.log_id,
            "vehicle": score.vehicle,
            "software_version": score.software_version,
            "rank": scene.row.rank,
            "score": score.score,
            "reason": score.reasons[0].headline if score.reasons else "",
            "verdicts": json.dumps([each.model_dump() for each in scene.verdicts]),
            "contradictions": {"_cls": "Detections", "detections": _detections(scene, number)},
        }
    scene.release()


def _detections(scene: SceneToExport, frame: int) -> list[dict[str, Any]]:
    overlay, moving = scene.overlay, scene.labels.moving_instances
    tracks = {track.track_id: track for track in scene.score.tracks}
    found: list[dict[str, Any]] = []
    for instance in overlay.instances_of(frame).tolist():
        number = int(overlay.instance_track[instance])
        x, y, z, length, width, height, yaw = map(float, overlay.instance_boxes[instance])
        track = tracks.get(number)
        made: dict[str, Any] = {
            "_cls": "Detection",
            "attributes": {},
            "tags": [],
            "label": (track.class_name if track else "") or "object",
            "bounding_box": [],
            "location": [x, y, z],
            "dimensions": [length, width, height],
            "rotation": [0.0, 0.0, math.remainder(yaw, math.tau)],
            "index": number,
            MOVING_ATTRIBUTE: bool(moving[instance]),
        }
        if track is not None:
            blamed = track.attribution
            made |= {"kind": track.kind, "strength": track.strength}
            made |= {"wrong": blamed.wrong.value, "chance": blamed.chance} if blamed else {}
        found.append(made)
    return found


def digest_of_detections(detections: Sequence[Mapping[str, Any]]) -> str:
    """Digest what the detections of a frame label, to notice if a person changed any."""
    names = ("label", "location", "dimensions", "rotation", "index", MOVING_ATTRIBUTE)
    return digest_of_json([[each.get(name) for name in names] for each in detections])


def _write(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content) + "\n", encoding="utf-8")


FIFTYONE: Final = Format(
    name="fiftyone",
    text="A FiftyOne dataset: a 3D sample for each frame, contradictions as 3D detections.",
    folder=DATA,
    write_scene=write_scene,
    write_all=write_samples,
    reads_logs=True,
)
"""Opened by `fiftyone.Dataset.from_dir` with the type `FiftyOneDataset`."""
