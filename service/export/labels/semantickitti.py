"""Labels of `semantickitti`: a `.label` file for each frame, a word for each point."""

from typing import Final

import numpy as np

from service.errors import UsageError
from service.export.labels.exported import ExportedFrame, ExportedScene
from service.export.labels.finished import FinishedLabels
from service.export.labels.form import LabelForm
from service.export.labels.label_file import read_bytes


def read_frame(scene: ExportedScene, frame: ExportedFrame) -> FinishedLabels | None:
    """Read a `.label` file; a frame without a file has no labels.

    Raises:
        UsageError: If it cannot be read, or has half a label.
    """
    path = scene.place / "labels" / f"{frame.number:06d}.label"
    if not path.exists():
        return None
    data = read_bytes(path)
    if len(data) % 4:
        raise UsageError(f"cannot read labels: {len(data)} bytes are no whole labels ({path})")
    return FinishedLabels.of_words(np.frombuffer(data, dtype="<u4"))


SEMANTICKITTI_LABELS: Final = LabelForm(
    name="semantickitti",
    finished="labels/NNNNNN.label of each scene",
    exports=("semantickitti",),
    read_frame=read_frame,
)
"""Written by any tool for SemanticKITTI."""
