"""Files of LidarCODA, each found by an id and written whole or not at all."""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.errors import PermanentError
from workers.lab.lidarcoda.annotations import Dataset, Image
from workers.lab.lidarcoda.clustering import ClusteredBox

CLUSTERS: Final = "lidar_clustering"
INDICES: Final = "lidar_index"

_COLUMNS: Final = {Dataset.KITTI: 4, Dataset.NUSCENES: 5, Dataset.ONCE: 4}
"""Columns of a cloud: x, y, z, intensity, and the ring in nuScenes."""


def read_cloud(folder: Path, image: Image) -> NDArray[np.float64]:
    """Read `lidar/NNNN.bin`, the lidar frame of an image.

    Returns:
        (N, 3) points in the lidar space of the data set, metres.

    Raises:
        PermanentError: If the image has no lidar frame, or its size is no multiple of a point.
    """
    path = folder / "lidar" / f"{image.stem}.bin"
    columns = _COLUMNS[image.dataset]
    if not path.is_file():
        raise PermanentError(f"image {image.id} ({image.file_name}) has no lidar frame ({path})")
    values = read_floats(path, columns)
    return values[:, :3].astype(np.float64)


def read_floats(path: Path, columns: int) -> NDArray[np.float32]:
    """Read a headerless file of float32 rows.

    Raises:
        PermanentError: If the file cannot be read, or its size is no multiple of a row.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise PermanentError(f"cannot read {path}: {error.strerror}") from None
    if len(data) % (4 * columns):
        raise PermanentError(f"{len(data)} bytes are no rows of {columns} float32 numbers ({path})")
    return np.frombuffer(data, "<f4").reshape(-1, columns)


def write_array(path: Path, values: NDArray[np.generic]) -> None:
    """Write the bytes of an array, little endian, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")
    little = values.astype(values.dtype.newbyteorder("<"))
    temporary.write_bytes(np.ascontiguousarray(little).tobytes())
    temporary.replace(path)


def write_box(folder: Path, annotation_id: int, box: ClusteredBox) -> None:
    """Write the points of an annotation; the file of clusters is written last."""
    write_array(folder / INDICES / f"{annotation_id}.bin", box.index)
    write_array(folder / CLUSTERS / f"{annotation_id}.bin", box.columns)


def has_box(folder: Path, annotation_id: int) -> bool:
    """Test whether an annotation was clustered before."""
    return (folder / CLUSTERS / f"{annotation_id}.bin").is_file()


def read_box(folder: Path, annotation_id: int) -> ClusteredBox:
    """Read the points of an annotation.

    Raises:
        PermanentError: If a file is missing or damaged, or the two differ in length.
    """
    columns = read_floats(folder / CLUSTERS / f"{annotation_id}.bin", 7)
    path = folder / INDICES / f"{annotation_id}.bin"
    index = read_floats(path, 1).view("<i4").ravel()
    if len(index) != len(columns):
        raise PermanentError(f"{len(index)} indices for {len(columns)} points ({path})")
    return ClusteredBox(index.astype(np.int32), columns)
