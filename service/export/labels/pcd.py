"""Labels as `pcd`: the field `label` of the clouds of an export as `cvat` or `xtreme1`.

CVAT and Xtreme1 return boxes; programs that label points write the field again. Where the field
`index` is kept, points may have another order; where it is gone, they keep that of the export.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from service.errors import UsageError
from service.export.labels.exported import ExportedFrame, ExportedScene
from service.export.labels.finished import FinishedLabels
from service.export.labels.form import LabelForm
from service.export.labels.label_file import of_another_scene
from service.export.labels.pcd_file import read_pcd
from service.export.pcd import CVAT_CLOUDS, XTREME1_CLOUDS

MAX_CLASS: Final = 0xFFFF
"""Largest class of a field; a word has 16 bits for it."""


def read_frame(scene: ExportedScene, frame: ExportedFrame) -> FinishedLabels:
    """Read the labels of a cloud.

    Raises:
        UsageError: If it cannot be read, has no labels, or has points of another frame.
    """
    path = cloud_of(scene.place, frame.number)
    fields = read_pcd(path)
    if "label" not in fields:
        raise UsageError(f"cannot read labels: the cloud has no field 'label' ({path})")
    labels = _whole(fields["label"], "label", path, most=MAX_CLASS)
    if "index" in fields and len(labels) == frame.points:
        index = _whole(fields["index"], "index", path, most=frame.raw_points)
        order = np.argsort(index, kind="stable")
        if not np.array_equal(index[order], frame.index):
            raise of_another_scene(
                "point cloud", f"its index is not that of frame {frame.number}", path
            )
        labels = labels[order]
    return FinishedLabels.of_words(labels.astype(np.uint32))


def cloud_of(folder: Path, number: int) -> Path:
    """Return the path of a frame's cloud in a scene's folder, as `cvat` or `xtreme1` writes it."""
    clouds = XTREME1_CLOUDS if (folder / XTREME1_CLOUDS).is_dir() else CVAT_CLOUDS
    return folder / clouds / f"{number:06d}.pcd"


def _whole(values: NDArray[Any], name: str, path: Path, *, most: int) -> NDArray[np.int64]:
    """Return a field as whole numbers, whatever type a program gave it."""
    numbers = values.astype(np.float64)
    good = (numbers >= 0) & (numbers <= most) & (numbers == np.floor(numbers))
    if not good.all():
        first = numbers[~good][0]
        raise UsageError(
            f"cannot read labels: field {name!r} has {first:g}, and needs whole numbers from 0 to "
            f"{most} ({path})"
        )
    return numbers.astype(np.int64)


PCD_LABELS: Final = LabelForm(
    name="pcd",
    finished="the field label of each cloud",
    exports=("cvat", "xtreme1"),
    read_frame=read_frame,
)
"""Classes that editors of clouds write into a PCD; Supervisely reads the same field."""
