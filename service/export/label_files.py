"""Finished labels of an exported scene, by format: one reader each, in words of SemanticKITTI.

A word is the class in the lower 16 bits and the object in the upper 16. Every format gives the
labels in the order of the exported points.
"""

import json
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from service.errors import UsageError

Words = NDArray[np.uint32]
ReadLabels = Callable[[Path, int], Words | None]
"""Reads the words of a frame from a scene's folder; None where the frame has no labels."""


def read_semantickitti(folder: Path, number: int) -> Words | None:
    """Read a `.label` file.

    Raises:
        UsageError: If it cannot be read, or has half a label.
    """
    path = folder / "labels" / f"{number:06d}.label"
    if not path.exists():
        return None
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"cannot read labels: {error.strerror} ({path})") from None
    if len(data) % 4:
        raise UsageError(f"cannot read labels: {len(data)} bytes are no whole labels ({path})")
    return np.frombuffer(data, dtype="<u4")


def read_segments(folder: Path, number: int) -> Words | None:
    """Read the frame of a label of Segments.ai; a released label has the same form.

    Raises:
        UsageError: If it is no such label.
    """
    frames = _segments_frames(folder / "label.json")
    if number >= len(frames):
        return None
    try:
        frame = frames[number]
        classes = {each["id"]: each["category_id"] for each in frame["annotations"]}
        objects = {each["id"]: each.get("track_id", each["id"]) for each in frame["annotations"]}
        words = {key: classes[key] | (objects[key] & 0xFFFF) << 16 for key in classes}
        return np.array([words.get(each, 0) for each in frame["point_annotations"]], dtype="<u4")
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise UsageError(
            f"cannot read labels: frame {number} is no label of Segments.ai: "
            f"{type(error).__name__}: {error} ({folder / 'label.json'})"
        ) from None


@lru_cache(maxsize=1)
def _segments_frames(path: Path) -> list[Any]:
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
        whole = read.get("attributes", read)
        frames = whole["frames"]
    except FileNotFoundError:
        return []
    except (OSError, ValueError, KeyError, AttributeError) as error:
        raise UsageError(
            f"cannot read labels: no label of Segments.ai: {type(error).__name__} ({path})"
        ) from None
    return frames if isinstance(frames, list) else []


LABEL_FORMATS: Final[Mapping[str, ReadLabels]] = {
    "semantickitti": read_semantickitti,
    "segments": read_segments,
}
"""Formats that labels come back in, by the name that `import-labels --format` takes."""


def labels_in(name: str) -> ReadLabels:
    """Find the reader of a format.

    Raises:
        UsageError: If labels of that format are not read.
    """
    found = LABEL_FORMATS.get(name)
    if found is None:
        known = ", ".join(LABEL_FORMATS)
        raise UsageError(f"no labels of format {name!r} are read: --format is one of {known}")
    return found
