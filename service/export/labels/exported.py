"""Scenes of an export: their frames, and the place of each exported point in the raw message."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.overlay import Overlay
from schemas.score import SceneScore
from service.errors import UsageError
from service.export.frames_file import INDEX, NAME
from service.export.journal import need_inside
from service.export.labels.label_file import of_another_scene, read_json

MAX_POINTS: Final = 2**26
"""Points of one frame; the largest lidars have a few million."""

OpenCurrent = Callable[[str], tuple[SceneScore, Overlay]]
"""Reads the current record and overlay of a scene, by its id."""


@dataclass(frozen=True, slots=True)
class ExportedLidar:
    """A message whose points are part of an exported frame.

    Attributes:
        topic: Of the lidar.
        stamp_ns: Of the message, nanoseconds since the Unix epoch.
        first: Place of its first point in the frame.
    """

    topic: str
    stamp_ns: int
    first: int


@dataclass(frozen=True, eq=False)
class ExportedFrame:
    """One exported frame, with M of its N raw points.

    Attributes:
        number: Index of the frame in its scene.
        points: M.
        raw_points: N.
        read_index: Reads the index.
        lidars: The message of the main lidar, then those of further ones.
        pre_labels: Digest of the pre-labels that the export wrote; empty: there is none.
    """

    number: int
    points: int
    raw_points: int
    read_index: Callable[[], NDArray[np.int64]]
    lidars: tuple[ExportedLidar, ...]
    pre_labels: str

    @property
    def stamp_ns(self) -> int:
        """Return the stamp of the frame, nanoseconds since the Unix epoch."""
        return self.lidars[0].stamp_ns

    @cached_property
    def index(self) -> NDArray[np.int64]:
        """Return (M,) the place of each exported point in the raw message, rising.

        Raises:
            UsageError: If the index is damaged.
        """
        index = self.read_index()
        rises = len(index) == self.points and bool((np.diff(index) > 0).all())
        if not rises or (self.points and not 0 <= index[0] <= index[-1] < self.raw_points):
            raise UsageError(
                f"frame {self.number} has a damaged index to raw points: export it again"
            )
        return index


@dataclass(frozen=True, slots=True, eq=False)
class ExportedScene:
    """A scene of an export.

    Attributes:
        place: Its file or folder.
        scene_id: The scene.
        log_id: Its log.
        frames: Its frames.
        overlay: Its points, where the export has none; else None.
        numbers: Numbers of the objects of its cuboids, by name; they are the same in all frames.
    """

    place: Path
    scene_id: str
    log_id: str
    frames: tuple[ExportedFrame, ...]
    overlay: Overlay | None = None
    numbers: dict[str, int] = field(default_factory=dict)


def scene_in_folder(folder: Path, scene_id: str, _current: OpenCurrent) -> ExportedScene:
    """Read the frames of a scene from its `frames.json`.

    Raises:
        UsageError: If they cannot be read, or are of another scene.
    """
    path = folder / NAME
    about = read_json(path, what="list of an exported scene's frames")
    try:
        found, log_id = str(about["scene_id"]), str(about["log_id"])
        need_inside(log_id, what="log_id", path=path)
        frames = tuple(_frame(folder, each) for each in about["frames"])
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise UsageError(
            f"cannot read the frames of an exported scene: {type(error).__name__}: {error} ({path})"
        ) from None
    if found != scene_id:
        raise of_another_scene("list of frames", f"{found!r}, not {scene_id!r}", path)
    return ExportedScene(folder, scene_id, log_id, frames)


def _frame(folder: Path, about: dict[str, Any]) -> ExportedFrame:
    number, points, raw = int(about["index"]), int(about["points"]), int(about["raw_points"])
    if number < 0 or not 0 <= points <= raw <= MAX_POINTS:
        raise ValueError(f"frame {number} with {points} of {raw} points")
    path = folder / INDEX / f"{number:06d}.bin"

    def read_index() -> NDArray[np.int64]:
        try:
            return np.fromfile(path, dtype="<u4").astype(np.int64)
        except OSError as error:
            raise UsageError(f"cannot read the index: {error.strerror} ({path})") from None

    lidars = [ExportedLidar(str(about["topic"]), int(about["header_stamp"]), 0)]
    for each in about.get("lidars", []):
        further = ExportedLidar(str(each["topic"]), int(each["header_stamp"]), int(each["first"]))
        lidars.append(further)
    firsts = [each.first for each in lidars]
    if firsts != sorted(firsts) or firsts[-1] > raw:
        raise ValueError(f"frame {number} with lidars that do not follow each other")
    pre_labels = str(about.get("pre_labels", ""))
    return ExportedFrame(number, points, raw, read_index, tuple(lidars), pre_labels)
