"""Points of an exported frame, from its own cloud."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.export.labels.exported import ExportedFrame
from service.export.labels.label_file import of_another_scene
from service.export.labels.pcd_file import read_pcd


def points_of(folder: Path, frame: ExportedFrame) -> NDArray[np.floating[Any]]:
    """Read the points of a frame in the order in which they were exported.

    Args:
        folder: Folder of the scene's clouds.
        frame: The frame.

    Returns:
        (M, 3) sensor space, metres.

    Raises:
        UsageError: If the cloud is missing, or is another one than the export wrote.
    """
    path = folder / f"{frame.number:06d}.pcd"
    fields = read_pcd(path)
    if "index" not in fields or not np.array_equal(fields["index"], frame.index):
        why = f"its index is not that of frame {frame.number}"
        raise of_another_scene("point cloud", why, path)
    return np.column_stack([fields[axis] for axis in "xyz"]).astype(np.float64)
