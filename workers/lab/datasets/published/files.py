"""Files of data sets: numbered frames, binary clouds, matrices, calibrations, stamps, images."""

import json
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from schemas.arrays import NS_PER_S, Transform
from workers.lab.datasets.conversion.source import DatasetUnusableError

XYZI: Final = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
"""Fields of a cloud without times."""

_STAMP: Final = re.compile(r"(\d{4})-(\d\d)-(\d\d) (\d\d):(\d\d):(\d\d)(?:\.(\d{1,9}))?$")


def numbered(folder: Path, suffix: str, *, what: str, gaps: bool = False) -> dict[int, Path]:
    """List the files `NUMBER + suffix` of a folder by their number.

    Args:
        folder: The folder.
        suffix: End of the names.
        what: Plural of what they are, for messages.
        gaps: Whether numbers may be missing.

    Raises:
        DatasetUnusableError: If there is none, or a number between the first and last is missing.
    """
    found = {}
    for path in folder.glob(f"*{suffix}") if folder.is_dir() else ():
        stem = path.name.removesuffix(suffix)
        if stem.isdecimal():
            found[int(stem)] = path
    if not found:
        raise DatasetUnusableError(f"no {what} in {folder}")
    ordered = dict(sorted(found.items()))
    first, last = min(ordered), max(ordered)
    if not gaps and len(ordered) != last - first + 1:
        missing = next(n for n in range(first, last) if n not in ordered)
        raise DatasetUnusableError(
            f"frame {missing} is missing between {ordered[first].name} and {ordered[last].name}: "
            f"unpack the {what} again ({folder})"
        )
    return ordered


def read_bytes(path: Path) -> bytes:
    """Read a file of a data set.

    Raises:
        DatasetUnusableError: If it is missing or cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise DatasetUnusableError(f"cannot read {path}: {error.strerror}") from None


def read_text(path: Path) -> str:
    """Read a text file of a data set; raises as `read_bytes` does."""
    try:
        return read_bytes(path).decode()
    except UnicodeDecodeError:
        raise DatasetUnusableError(f"no text: {path}") from None


def read_json(path: Path) -> Any:
    """Read a JSON file of a data set; raises as `read_bytes` does, and where it is damaged."""
    try:
        return json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise DatasetUnusableError(f"damaged JSON: {error} ({path})") from None


def read_floats(path: Path, columns: int) -> NDArray[np.float32]:
    """Read a file of little-endian float32 rows.

    Returns:
        (N, columns).

    Raises:
        DatasetUnusableError: If it is missing, or its size is no multiple of a row.
    """
    data = read_bytes(path)
    if len(data) % (4 * columns):
        raise DatasetUnusableError(
            f"{path} has {len(data)} bytes, no multiple of {4 * columns} for points of {columns} "
            "float32: the file is cut"
        )
    return np.frombuffer(data, "<f4").reshape(-1, columns)


def rows_of(points: NDArray[np.floating], intensity: NDArray[Any]) -> NDArray[Any]:
    """Return the rows of a cloud of x, y, z and intensity."""
    rows = np.zeros(len(points), XYZI)
    rows["x"], rows["y"], rows["z"] = points[:, 0], points[:, 1], points[:, 2]
    rows["intensity"] = intensity
    return rows


def key_values(path: Path) -> dict[str, NDArray[np.float64]]:
    """Read a calibration file of KITTI: lines `NAME: numbers`; other lines are left out."""
    found = {}
    for line in read_text(path).splitlines():
        name, colon, rest = line.partition(":")
        if not colon:
            name, _, rest = line.partition(" ")
        try:
            found[name.strip()] = np.array(rest.split(), np.float64)
        except ValueError:
            continue
    return found


def matrix_of(
    values: Mapping[str, NDArray[np.float64]], name: str, shape: tuple[int, int], path: Path
) -> NDArray[np.float64]:
    """Return one matrix of a calibration.

    Raises:
        DatasetUnusableError: If it is missing or has another number of values.
    """
    found = values.get(name)
    if found is None or found.size != shape[0] * shape[1]:
        raise DatasetUnusableError(
            f"no {name} of {shape[0]} x {shape[1]} numbers in the calibration {path}"
        )
    return found.reshape(shape)


def square(matrix: NDArray[np.floating]) -> Transform:
    """Return a (4, 4) transform from its upper three rows, or from the whole."""
    full: Transform = np.eye(4)
    full[: len(matrix)] = matrix
    return full


def pose_rows(path: Path, columns: int) -> NDArray[np.float64]:
    """Read a file of poses, a line each.

    Raises:
        DatasetUnusableError: If a line has another number of values.
    """
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if not line.strip():
            continue
        try:
            values = [float(each) for each in line.split()]
        except ValueError:
            values = []
        if len(values) != columns or not np.isfinite(values).all():
            raise DatasetUnusableError(
                f"line {number} of {path} is no pose of {columns} finite numbers"
            )
        rows.append(values)
    return np.array(rows, np.float64).reshape(-1, columns)


def stamps_of(path: Path) -> list[int]:
    """Read lines `YYYY-MM-DD HH:MM:SS.nanoseconds` as nanoseconds since the Unix epoch, UTC."""
    stamps = []
    for line in read_text(path).splitlines():
        if not line.strip():
            continue
        found = _STAMP.match(line.strip())
        if found is None:
            raise DatasetUnusableError(f"no time: {line.strip()!r} ({path})")
        year, month, day, hour, minute, second = (int(each) for each in found.groups()[:6])
        whole = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
        fraction = (found.group(7) or "").ljust(9, "0")
        stamps.append(int(whole.timestamp()) * NS_PER_S + int(fraction))
    return stamps


def image_size(path: Path) -> tuple[int, int]:
    """Return width and height of an image, pixels.

    Raises:
        DatasetUnusableError: If it is no image.
    """
    try:
        with Image.open(path) as image:
            return image.size
    except (OSError, UnidentifiedImageError):
        raise DatasetUnusableError(f"no image: {path}") from None


def need_frames_of(images: Sequence[int], lidar: Mapping[int, Any], *, folder: Path) -> None:
    """Refuse images of frames that the lidar lacks.

    Raises:
        DatasetUnusableError: If there is such an image.
    """
    lacking = next((number for number in images if number not in lidar), None)
    if lacking is not None:
        raise DatasetUnusableError(
            f"image {lacking} has no lidar frame of its number: unpack the lidar again, or leave "
            f"cameras out with --cameras none ({folder})"
        )
