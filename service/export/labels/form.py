"""Interface of a form of finished labels: it reads those of one frame of an exported scene."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from service.export.labels.exported import (
    ExportedFrame,
    ExportedScene,
    OpenCurrent,
    scene_in_folder,
)
from service.export.labels.finished import FinishedLabels

ReadFrame = Callable[[ExportedScene, ExportedFrame], FinishedLabels | None]
"""Reads the labels of a frame; None where the frame has none.

It raises UsageError where a file cannot be read, or belongs to another scene."""

OpenScene = Callable[[Path, str, OpenCurrent], ExportedScene]
"""Finds the frames of a scene from its place and its id; raises UsageError where it cannot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelForm:
    """One form of finished labels, as `import-labels --format` names it.

    Attributes:
        name: As `--format` names it.
        finished: The files that it reads, as a message names them.
        exports: Formats of the exports whose scenes it labels.
        read_frame: Reads the labels of a frame.
        open_scene: Finds the frames of a scene; most exports list them in `frames.json`.
    """

    name: str
    finished: str
    exports: tuple[str, ...]
    read_frame: ReadFrame
    open_scene: OpenScene = scene_in_folder
