"""Point labels of graded images, in the published layout.

Source: the paper's notebooks for LidarCODA, step D. Files contain float32 rows x, y, z, label;
`lidar_labels` in the lidar space of the data set, `original_labels` in KITTI's axes. Folders that
end with `_annotation` contain a file per annotation.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.lab.lidarcoda.annotations import Dataset, Image
from workers.lab.lidarcoda.clustering import ClusteredBox
from workers.lab.lidarcoda.files import write_array
from workers.lab.lidarcoda.grades import object_labels

NATIVE: Final = "lidar_labels"
KITTI_AXES: Final = "original_labels"
PER_ANNOTATION: Final = "_annotation"

FIRST_ROW: Final = (-1.0, -1.0, -1.0, -1.0)
"""Row with which every published file of an image begins; the corrected form leaves it out."""


def write_labels(
    out: Path,
    image: Image,
    boxes: Mapping[int, ClusteredBox],
    grades: Mapping[int, int],
    *,
    published: bool,
) -> None:
    """Write the labels of one image and of each of its annotations.

    Args:
        out: Folder of the build.
        image: The image; all its annotations have a grade.
        boxes: Its boxes by annotation id.
        grades: Grades by annotation id.
        published: True for the published form: a first row of -1, and points in two boxes twice.
    """
    rows = {key: labelled_rows(box, grades[key]) for key, box in boxes.items()}
    for key, own in rows.items():
        _write_both(out, PER_ANNOTATION, str(key), own, image)
    if published:
        first = np.array([FIRST_ROW], np.float32)
        merged = np.unique(np.vstack((first, *rows.values())), axis=0)
    else:
        merged = _merge(boxes, rows)
    _write_both(out, "", image.stem, merged, image)


def labelled_rows(box: ClusteredBox, grade: int) -> NDArray[np.float32]:
    """Return (N, 4) x, y, z in metres, and +1 of the object or -1 not."""
    labels = object_labels(box, grade)
    return np.column_stack((box.columns[:, :3], labels)).astype(np.float32)


def kitti_axes(rows: NDArray[np.float32], dataset: Dataset) -> NDArray[np.float32]:
    """Turn x, y, z of rows to KITTI's axes: x forward, y left, z up."""
    turned = rows.copy()
    x, y = rows[:, 0], rows[:, 1]
    if dataset is Dataset.NUSCENES:  # x right, y forward
        turned[:, 0], turned[:, 1] = y, -x
    elif dataset is Dataset.ONCE:  # x left, y backward
        turned[:, 0], turned[:, 1] = -y, x
    return turned


def _write_both(out: Path, suffix: str, stem: str, rows: NDArray[np.float32], image: Image) -> None:
    write_array(out / f"{NATIVE}{suffix}" / f"{stem}.bin", rows)
    write_array(out / f"{KITTI_AXES}{suffix}" / f"{stem}.bin", kitti_axes(rows, image.dataset))


def _merge(
    boxes: Mapping[int, ClusteredBox], rows: Mapping[int, NDArray[np.float32]]
) -> NDArray[np.float32]:
    """List each raw point once, by its index; it is of the object if it is so in one box."""
    index = np.concatenate([boxes[key].index for key in rows])
    every = np.vstack(list(rows.values()))
    order = np.lexsort((-every[:, 3], index))
    first = np.ones(len(order), np.bool_)
    first[1:] = np.diff(index[order]) > 0
    merged: NDArray[np.float32] = every[order[first]]
    return merged
