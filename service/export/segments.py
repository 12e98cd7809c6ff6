"""Format `segments`: a sequence of Segments.ai for each scene, with pre-labels of every point.

`sample.json` and `label.json` have the attributes of its API. The URLs of the clouds are relative:
they become those of the uploaded files.
"""

import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from service.export.classes import NAMES
from service.export.format import Format
from service.export.frames_file import frame_of, pose_from_first, write_frames, write_index
from service.export.points import LabelledCloud
from service.export.rotation import quaternion_wxyz
from service.export.scene import SceneToExport
from service.export.semantickitti import labels_of

FORMAT_VERSION: Final = "0.2"
"""Version of the form of labels of sequences of point clouds."""


def write_scene(scene: SceneToExport, folder: Path) -> None:
    """Write the sequence of one scene.

    Raises:
        PermanentError: If the log is gone, or no longer has the frames.
    """
    (folder / "pcd").mkdir(parents=True)
    frames: list[dict[str, Any]] = []
    samples: list[dict[str, Any]] = []
    labels: list[dict[str, Any]] = []
    numbers: dict[int, int] = {}
    first: LabelledCloud | None = None
    for cloud in scene.clouds():
        first = first or cloud
        name = f"pcd/{cloud.number:06d}.bin"
        np.column_stack([cloud.points_m, cloud.intensity]).astype("<f4").tofile(folder / name)
        write_index(cloud, folder)
        samples.append(
            {
                "pcd": {"url": name, "type": "binary-xyzi"},
                "ego_pose": _pose(pose_from_first(cloud, first)),
                "timestamp": str(cloud.stamp_ns),
                "name": f"{cloud.number:06d}",
            }
        )
        labels.append(_label(cloud, numbers))
        frames.append(frame_of(cloud, scene))
    _write(folder / "sample.json", {"name": scene.stem, "attributes": {"frames": samples}})
    _write(folder / "label.json", {"format_version": FORMAT_VERSION, "frames": labels})
    categories = [{"id": number, "name": name} for number, name in NAMES.items() if number]
    _write(folder / "categories.json", {"format_version": "0.1", "categories": categories})
    write_frames(scene, frames, folder)


def _label(cloud: LabelledCloud, numbers: dict[int, int]) -> dict[str, Any]:
    """Return the label of a frame: an annotation for each class, and for each track in a class.

    Args:
        cloud: The frame.
        numbers: Number of each annotation of the sequence, by class and track; it grows.
    """
    words, place = np.unique(labels_of(cloud), return_inverse=True)
    ids: list[int] = []
    annotations: list[dict[str, int]] = []
    for word in words.tolist():
        if word == 0:
            ids.append(0)
            continue
        number = numbers.setdefault(word, len(numbers) + 1)
        ids.append(number)
        category = word & 0xFFFF
        annotations.append({"id": number, "category_id": category, "track_id": number})
    annotations = [each for each in annotations if each["category_id"]]
    points: NDArray[np.int64] = np.array(ids, dtype=np.int64)[place.reshape(-1)]
    return {
        "format_version": FORMAT_VERSION,
        "timestamp": str(cloud.stamp_ns),
        "annotations": annotations,
        "point_annotations": points.tolist(),
    }


def _pose(pose: NDArray[np.float64]) -> dict[str, dict[str, float]]:
    w, x, y, z = quaternion_wxyz(pose[:3, :3])
    position = dict(zip("xyz", pose[:3, 3].tolist(), strict=True))
    return {"position": position, "heading": {"qw": w, "qx": x, "qy": y, "qz": z}}


def _write(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content) + "\n", encoding="utf-8")


SEGMENTS: Final = Format(
    name="segments",
    text="Sequences of Segments.ai: clouds, poses, and a pre-label of every point.",
    write_scene=write_scene,
    reads_logs=True,
)
"""Sample and label as its API takes them."""
