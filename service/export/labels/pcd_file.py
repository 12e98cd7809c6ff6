"""Reading of PCD 0.7, ascii or binary, as other programs write it."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from service.export.labels.exported import MAX_POINTS
from service.export.labels.label_file import read_bytes, unlike

_KINDS: Final = {"F": "f", "U": "u", "I": "i"}
_SIZES: Final = frozenset({1, 2, 4, 8})
_WHAT: Final = "point cloud (PCD)"

MAX_HEADER: Final = 2**16
"""Bytes of a header at most."""

MAX_FIELDS: Final = 64
"""Fields of a point at most."""


def read_pcd(path: Path) -> dict[str, NDArray[Any]]:
    """Read the fields of a point cloud.

    Args:
        path: The file.

    Returns:
        (N,) of each field that has one number a point, by its name.

    Raises:
        UsageError: If the file cannot be read, is compressed, or has more or fewer bytes than its
            header states.
    """
    data = read_bytes(path)
    try:
        header, begin = _header(data)
        kind, points = _point_of(header), int(header["POINTS"][0])
        if not 0 <= points <= MAX_POINTS:
            raise ValueError(f"{points} points")
        form = header["DATA"][0]
        if form == "binary_compressed":
            raise ValueError("DATA binary_compressed: write it as binary or ascii")
        read = {"binary": _binary, "ascii": _ascii}[form](data[begin:], kind, points)
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise unlike(_WHAT, error, path) from None
    return {name: read[name] for name in kind.names or () if read[name].ndim == 1}


def _header(data: bytes) -> tuple[dict[str, list[str]], int]:
    """Return the lines of the header by their first word, and the place of the first point."""
    header: dict[str, list[str]] = {}
    place = 0
    while "DATA" not in header:
        end = data.find(b"\n", place, MAX_HEADER)
        if end < 0:
            raise ValueError("it has no line DATA")
        words = data[place:end].decode("ascii", errors="replace").split()
        place = end + 1
        if words and not words[0].startswith("#"):
            header[words[0]] = words[1:]
    return header, place


def _point_of(header: dict[str, list[str]]) -> np.dtype[Any]:
    names, kinds = header["FIELDS"], header["TYPE"]
    sizes = [int(each) for each in header["SIZE"]]
    counts = [int(each) for each in header.get("COUNT", ["1"] * len(names))]
    if not len(names) == len(kinds) == len(sizes) == len(counts) <= MAX_FIELDS:
        raise ValueError("FIELDS, SIZE, TYPE and COUNT do not fit each other")
    if not _SIZES.issuperset(sizes) or not all(0 < each <= MAX_FIELDS for each in counts):
        raise ValueError("a field of an unknown size")
    fields: list[Any] = []
    for place, (name, kind, size, count) in enumerate(
        zip(names, kinds, sizes, counts, strict=True)
    ):
        named = f"{name}{place}" if name == "_" else name  # padding has one name everywhere
        fields.append((named, f"<{_KINDS[kind]}{size}", *([(count,)] if count > 1 else [])))
    return np.dtype(fields)


def _binary(data: bytes, kind: np.dtype[Any], points: int) -> NDArray[Any]:
    if len(data) != points * kind.itemsize:
        raise ValueError(f"{len(data)} bytes for {points} points of {kind.itemsize} bytes")
    return np.frombuffer(data, dtype=kind)


def _ascii(data: bytes, kind: np.dtype[Any], points: int) -> NDArray[Any]:
    lines = data.decode("ascii").splitlines()
    rows = np.loadtxt(lines, dtype=kind, ndmin=1) if points else np.zeros(0, dtype=kind)
    if len(rows) != points:
        raise ValueError(f"{len(rows)} lines for {points} points")
    return rows
