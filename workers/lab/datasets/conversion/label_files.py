"""Files of classes next to a log, in SemanticKITTI's form: one `.label` per frame."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.lab.datasets.conversion.boxes import DYNAMIC
from workers.lab.datasets.conversion.source import SourceFrame

_MOVING_OF: Final[Mapping[int, int]] = {
    10: 252, 11: 253, 31: 253, 30: 254, 15: 255, 32: 255, 16: 256, 13: 257, 18: 258, 20: 259,
}  # fmt: skip
"""Id of a class in motion, by its id at rest; a bicycle in motion has a rider."""


class LabelWriter:
    """Writes `NNNNNN.label` per frame, the form that the option `--predictions` reads.

    Args:
        folder: Folder of the log's files.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._index = folder, 0

    def add(self, frame: SourceFrame) -> None:
        """Write the next frame; one without classes has no file."""
        if frame.label_ids is not None:
            self._folder.mkdir(parents=True, exist_ok=True)
            path = self._folder / f"{self._index:06d}.label"
            ids = with_motion(frame.label_ids, frame.truth.get("motion"))
            path.write_bytes(ids.astype(np.dtype("<u4")).tobytes())
        self._index += 1


def with_motion(
    label_ids: NDArray[np.uint32], motion: NDArray[np.generic] | None
) -> NDArray[np.uint32]:
    """Return ids in which dynamic points of movable classes have the id of the class in motion."""
    if motion is None:
        return label_ids
    moving = np.arange(1 << 16, dtype=np.uint32)
    moving[list(_MOVING_OF)] = list(_MOVING_OF.values())
    turned = (label_ids & np.uint32(0xFFFF0000)) | moving[label_ids & 0xFFFF]
    return np.where(motion == DYNAMIC, turned, label_ids).astype(np.uint32)
