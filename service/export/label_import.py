"""Import of finished labels: each returns to its raw point by index, and becomes truth.

The result has the form of `deploy/TRUTH.md`. A point that was not exported, since it has no return,
is unlabelled.
"""

import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from service.errors import UsageError
from service.export.frames_file import INDEX, NAME, digest_of
from service.export.journal import need_inside, scenes_of
from service.export.label_files import ReadLabels

UNKNOWN, STATIC, DYNAMIC = 0, 1, 2
"""Values of `motion` in a folder of truth."""

FIRST_MOVING: Final = 251
"""First class of SemanticKITTI that names a moving thing; 251 is that of its motion benchmark."""

_OUTLIER: Final = 1

MAX_POINTS: Final = 2**26
"""Points of one message; the largest lidars have a few million."""

LEARNING: Final = {
    10: 1,
    11: 2,
    13: 5,
    15: 3,
    16: 5,
    18: 4,
    20: 5,
    30: 6,
    31: 7,
    32: 8,
    40: 9,
    44: 10,
    48: 11,
    49: 12,
    50: 13,
    51: 14,
    60: 9,
    70: 15,
    71: 16,
    72: 17,
    80: 18,
    81: 19,
    252: 1,
    253: 7,
    254: 6,
    255: 8,
    256: 5,
    257: 5,
    258: 4,
    259: 5,
}
"""Number of the 19 classes for each id, as in `semantic-kitti.yaml`; others are 0."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelledFrame:
    """Finished labels of one message.

    Attributes:
        number: Index of the frame in its scene.
        stamp_ns: Of the frame.
        topic: Of the lidar.
        words: (N,) words of SemanticKITTI for each raw point, 0 where none was exported.
        is_unchanged: Whether every class is still the pre-label of the export.
        first: Place of its first point in the frame; not 0 for a lidar that was joined to another.
    """

    number: int
    stamp_ns: int
    topic: str
    words: NDArray[np.uint32]
    is_unchanged: bool = False
    first: int = 0

    @property
    def motion(self) -> NDArray[np.uint8]:
        """Return (N,) 0 unknown, 1 static, 2 dynamic."""
        classes = self.words & 0xFFFF
        motion = np.where(classes >= FIRST_MOVING, DYNAMIC, STATIC)
        return np.where(classes <= _OUTLIER, UNKNOWN, motion).astype(np.uint8)

    @property
    def semantic19(self) -> NDArray[np.uint8]:
        """Return (N,) numbers of the 19 classes."""
        table = np.zeros(2**16, dtype=np.uint8)
        table[list(LEARNING)] = list(LEARNING.values())
        found: NDArray[np.uint8] = table[self.words & 0xFFFF]
        return found

    @property
    def track(self) -> NDArray[np.int16]:
        """Return (N,) objects, -1 none."""
        objects = (self.words >> 16).astype(np.int32)
        return np.where(objects == 0, -1, np.minimum(objects, 32_767)).astype(np.int16)


@dataclass(frozen=True, slots=True)
class ImportedScene:
    """A scene of an export, with its finished labels.

    Attributes:
        scene_id: The scene.
        log_id: Its log.
        frames: Its frames that have labels.
        unlabelled: Frames that have none.
    """

    scene_id: str
    log_id: str
    frames: tuple[LabelledFrame, ...]
    unlabelled: int


def read_scenes(folder: Path, read: ReadLabels, *, form: str) -> Iterator[ImportedScene]:
    """Read the labels of an export.

    Args:
        folder: The folder of the export.
        read: Reads the labels of a frame.
        form: Name of the format.

    Raises:
        UsageError: If the folder is no export in that format, or if labels do not fit the points.
    """
    for place in scenes_of(folder, format_name=form):
        yield _read_scene(folder / place, read)


def _read_scene(folder: Path, read: ReadLabels) -> ImportedScene:
    path = folder / NAME
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
        read_frames = [_read_frame(folder, each, read) for each in about["frames"]]
        scene_id, log_id = str(about["scene_id"]), str(about["log_id"])
        need_inside(log_id, what="log_id", path=path)
    except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
        raise UsageError(
            f"cannot read the frames of an exported scene: {type(error).__name__}: {error} ({path})"
        ) from None
    found = tuple(each for frame in read_frames for each in frame)
    return ImportedScene(scene_id, log_id, found, sum(not frame for frame in read_frames))


def _read_frame(folder: Path, about: dict[str, Any], read: ReadLabels) -> list[LabelledFrame]:
    """Read the labels of a frame: one for its message, and one for that of each further lidar."""
    number, points, raw = int(about["index"]), int(about["points"]), int(about["raw_points"])
    if not 0 <= points <= raw <= MAX_POINTS:
        raise ValueError(f"frame {number} with {points} of {raw} points")
    words = read(folder, number)
    if words is None:
        return []
    index = np.fromfile(folder / INDEX / f"{number:06d}.bin", dtype="<u4").astype(np.int64)
    if len(words) != points:
        raise UsageError(
            f"frame {number} has {len(words)} labels for {points} points: labels need the order "
            f"of the exported points, one each ({folder})"
        )
    rises = len(index) == points and bool((np.diff(index) > 0).all())
    if not rises or (points and not 0 <= index[0] <= index[-1] < raw):
        raise UsageError(
            f"frame {number} has a damaged index to raw points: export it again ({folder})"
        )
    of_raw = np.zeros(raw, dtype=np.uint32)
    of_raw[index] = words
    is_unchanged = digest_of(words) == about.get("pre_labels")
    further = about.get("lidars", [])
    ends = [int(each["first"]) for each in further] + [raw]
    if ends != sorted(ends) or ends[0] < 0:
        raise ValueError(f"frame {number} with lidars that do not follow each other")
    of_main = of_raw[: ends[0]]
    stamp_ns, topic = int(about["header_stamp"]), str(about["topic"])
    found = [LabelledFrame(number, stamp_ns, topic, of_main, is_unchanged)]
    for each, first, end in zip(further, ends, ends[1:], strict=False):
        if end > first:
            stamp_ns, topic = int(each["header_stamp"]), str(each["topic"])
            words_of = of_raw[first:end]
            found.append(LabelledFrame(number, stamp_ns, topic, words_of, is_unchanged, first))
    return found


def write_truth(scenes: list[ImportedScene], folder: Path) -> int:
    """Write a folder of truth for each log, whole or not at all; return the number of frames.

    Frames of all scenes of a log are numbered in the order of their stamps, those of further lidars
    after the others.

    Args:
        scenes: The scenes.
        folder: The folder, empty or new.
    """
    growing = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    try:
        growing.mkdir(parents=True)
        written = _write_logs(scenes, growing)
        growing.replace(folder)
    finally:
        shutil.rmtree(growing, ignore_errors=True)
    return written


def _write_logs(scenes: list[ImportedScene], folder: Path) -> int:
    written = 0
    for log_id in sorted({each.log_id for each in scenes}):
        frames = sorted(
            (frame for scene in scenes if scene.log_id == log_id for frame in scene.frames),
            key=lambda frame: (frame.first > 0, frame.topic, frame.stamp_ns),
        )
        place = folder / log_id
        place.mkdir(parents=True, exist_ok=True)
        listed: list[dict[str, Any]] = []
        for number, frame in enumerate(frames):
            np.savez_compressed(
                place / f"{number:06d}.npz",
                motion=frame.motion,
                track=frame.track,
                semantic19=frame.semantic19,
            )
            listed.append({"index": number, "topic": frame.topic, "header_stamp": frame.stamp_ns})
        (place / "frames.json").write_text(
            json.dumps({"partial": True, "frames": listed}, indent=1) + "\n"
        )
        written += len(frames)
    return written
