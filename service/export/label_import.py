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
from service.export.journal import scenes_of
from service.export.labels.exported import ExportedFrame, ExportedScene, OpenCurrent
from service.export.labels.finished import FinishedLabels, unknown_class
from service.export.labels.form import LabelForm

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
        motion: (N,) 0 unknown, 1 static, 2 dynamic; unknown where none was exported.
        is_unchanged: Whether the frame still has the pre-labels of the export.
        first: Place of its first point in the frame; not 0 for a lidar that was joined to another.
    """

    number: int
    stamp_ns: int
    topic: str
    words: NDArray[np.uint32]
    motion: NDArray[np.uint8]
    is_unchanged: bool = False
    first: int = 0

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

    @property
    def is_unchanged(self) -> bool:
        """Return whether it has labels, and all of them are the pre-labels of the export."""
        return bool(self.frames) and all(frame.is_unchanged for frame in self.frames)


def read_scenes(folder: Path, form: LabelForm, current: OpenCurrent) -> Iterator[ImportedScene]:
    """Read the labels of an export.

    Args:
        folder: The folder of the export.
        form: The form of the labels.
        current: Reads the current record and overlay of a scene.

    Raises:
        UsageError: If the folder is no export that such labels are of, if labels do not fit the
            points, or if no frame has labels.
    """
    labelled = 0
    for place, scene_id in scenes_of(folder, format_names=form.exports):
        scene = _read_scene(form.open_scene(folder / place, scene_id, current), form)
        labelled += len(scene.frames)
        yield scene
    if not labelled:
        raise UsageError(
            f"no frame of this export has labels of format {form.name}: put its finished files "
            f"there, {form.finished} ({folder})"
        )


def _read_scene(scene: ExportedScene, form: LabelForm) -> ImportedScene:
    read = [_read_frame(scene, frame, form) for frame in scene.frames]
    found = tuple(each for frame in read for each in frame)
    return ImportedScene(scene.scene_id, scene.log_id, found, sum(not frame for frame in read))


def _read_frame(scene: ExportedScene, frame: ExportedFrame, form: LabelForm) -> list[LabelledFrame]:
    """Read the labels of a frame: one for its message, and one for that of each further lidar."""
    labels = form.read_frame(scene, frame)
    if labels is None:
        return []
    _check(labels, scene, frame)
    words = np.zeros(frame.raw_points, dtype=np.uint32)
    motion = np.zeros(frame.raw_points, dtype=np.uint8)
    words[frame.index], motion[frame.index] = labels.words, labels.motion
    is_unchanged = bool(labels.digest) and labels.digest == frame.pre_labels
    ends = [*(each.first for each in frame.lidars[1:]), frame.raw_points]
    return [
        LabelledFrame(
            number=frame.number,
            stamp_ns=lidar.stamp_ns,
            topic=lidar.topic,
            words=words[lidar.first : end],
            motion=motion[lidar.first : end],
            is_unchanged=is_unchanged,
            first=lidar.first,
        )
        for lidar, end in zip(frame.lidars, ends, strict=True)
        if end > lidar.first or lidar is frame.lidars[0]
    ]


def _check(labels: FinishedLabels, scene: ExportedScene, frame: ExportedFrame) -> None:
    if len(labels.words) != frame.points:
        raise UsageError(
            f"frame {frame.number} has {len(labels.words)} labels for {frame.points} points: "
            f"labels need the order of the exported points, one each ({scene.place})"
        )
    strange = unknown_class(labels.words)
    if strange is not None:
        raise UsageError(
            f"frame {frame.number} has labels of class {strange}, which SemanticKITTI does not "
            f"have ({scene.place})"
        )


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
