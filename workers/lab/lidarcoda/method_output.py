"""Output of a method on CODA's frames: points with one of the four categories of the paper."""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.errors import PermanentError
from workers.lab.lidarcoda.annotations import Image
from workers.lab.lidarcoda.files import read_floats

ANNOTATED_FRAME: Final = 8
"""Place of the annotated frame in a published sequence of 17 frames."""

_SEQUENCES: Final = "anomalies_sup_self"


def read_method(folder: Path, image: Image) -> tuple[NDArray[np.float32], NDArray[np.int64]] | None:
    """Read the categories of the frame of one image.

    Two forms are read. `NNNN.bin` contains float32 rows x, y, z, category. The published form is
    `anomalies_sup_self/NAME/pc_velo_camerafov/NAME_8.bin` (float32 x, y, z) next to
    `anomaly_labels/NAME_8.bin` (int16), where NAME is the file name of the image without ending.

    Returns:
        (N, 3) points in KITTI's axes, metres, and (N,) categories 1 to 4; None if the method has no
        output for the image.

    Raises:
        PermanentError: If a file is damaged, points and categories differ in number, or a category
            is not 1 to 4.
    """
    path = folder / f"{image.stem}.bin"
    if path.is_file():
        rows = read_floats(path, 4)
        return _checked(path, rows[:, :3], rows[:, 3])
    name = Path(image.file_name).stem
    frame = f"{name}_{ANNOTATED_FRAME}.bin"
    points = folder / _SEQUENCES / name / "pc_velo_camerafov" / frame
    labels = folder / _SEQUENCES / name / "anomaly_labels" / frame
    if not points.is_file():
        return None
    try:
        data = labels.read_bytes()
    except OSError as error:
        raise PermanentError(f"image {image.id} has no categories: {error.strerror}") from None
    if len(data) % 2:
        raise PermanentError(f"{len(data)} bytes are no int16 categories ({labels})")
    return _checked(labels, read_floats(points, 3), np.frombuffer(data, "<i2"))


def _checked(
    path: Path, points: NDArray[np.float32], categories: NDArray[np.generic]
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    if len(points) != len(categories):
        raise PermanentError(f"{len(categories)} categories for {len(points)} points ({path})")
    whole = categories.astype(np.int64)
    if not np.isin(categories, (1, 2, 3, 4)).all():
        wrong = categories[~np.isin(categories, (1, 2, 3, 4))][0]
        raise PermanentError(f"{wrong} is no category from 1 to 4 ({path})")
    return points, whole
