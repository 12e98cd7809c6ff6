"""Labels of `segments`: `label.json` of each scene; a released label has the same form."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from service.export.labels.exported import ExportedFrame, ExportedScene
from service.export.labels.finished import FinishedLabels
from service.export.labels.form import LabelForm
from service.export.labels.label_file import of_another_scene, read_json, unlike

_WHAT: Final = "label of Segments.ai"


def read_frame(scene: ExportedScene, frame: ExportedFrame) -> FinishedLabels | None:
    """Read the frame of a label of Segments.ai; a frame beyond its last one has no labels.

    Raises:
        UsageError: If it is no such label, or that of another scene.
    """
    path, number = scene.place / "label.json", frame.number
    frames = _frames(path)
    if len(frames) > len(scene.frames):
        why = f"it has {len(frames)} frames, and the export {len(scene.frames)}"
        raise of_another_scene(_WHAT, why, path)
    if number >= len(frames):
        return None
    try:
        about = frames[number]
        stamp = about.get("timestamp")
        classes = {each["id"]: each["category_id"] for each in about["annotations"]}
        objects = {each["id"]: each.get("track_id", each["id"]) for each in about["annotations"]}
        words = {key: classes[key] | (objects[key] & 0xFFFF) << 16 for key in classes}
        found = np.array([words.get(each, 0) for each in about["point_annotations"]], dtype="<u4")
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError) as error:
        raise unlike(_WHAT, error, path, frame=number) from None
    if stamp is not None and str(stamp) != str(frame.stamp_ns):
        why = f"frame {number} has the timestamp {stamp}, and the export {frame.stamp_ns}"
        raise of_another_scene(_WHAT, why, path)
    return FinishedLabels.of_words(found)


def _frames(path: Path) -> list[Any]:
    if not path.exists():
        return []
    read = read_json(path, what=_WHAT)
    try:
        frames = read.get("attributes", read)["frames"]
        if not isinstance(frames, list):
            raise TypeError("frames are no list")
    except (KeyError, TypeError, AttributeError) as error:
        raise unlike(_WHAT, error, path) from None
    return frames


SEGMENTS_LABELS: Final = LabelForm(
    name="segments",
    finished="label.json of each scene",
    exports=("segments",),
    read_frame=read_frame,
)
"""Labels that its SDK releases."""
