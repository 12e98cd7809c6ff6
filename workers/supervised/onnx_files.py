"""Validation of ONNX files before the runtime opens them: their size, and the files they name.

An ONNX file is a protobuf message. Only fields that contain tensors are followed; the numbers of
the tensors are not read.
"""

import mmap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from schemas.runtime.real_path import real_path
from workers.checkpoints.errors import WeightsUnusableError
from workers.checkpoints.model_files import (
    MAX_NETWORK_BYTES,
    MAX_STRUCTURE_BYTES,
    open_regular,
)


def check_onnx(path: Path) -> tuple[Path, ...]:
    """Check an ONNX file and its external data files.

    Args:
        path: The `.onnx` file.

    Returns:
        The files that it names, by name, each once.

    Raises:
        WeightsUnusableError: If it is no ONNX file, has too large a graph, or names a file that is
            missing, not regular, too large, or outside the folder of the network.
    """
    found = _Found()
    with (
        open_regular(path, what="the network") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data,
    ):
        try:
            _walk(data, 0, len(data), "model", found)
        except _NoOnnxError as error:
            raise WeightsUnusableError(f"not an ONNX network: {error} ({path})") from error
        structure = len(data) - found.numbers
    if structure > MAX_STRUCTURE_BYTES:
        raise WeightsUnusableError(
            f"the graph of the network has {structure:,} bytes without its weights, and at most "
            f"{MAX_STRUCTURE_BYTES:,} are read ({path})"
        )
    beside = tuple(_beside(name, path) for name in sorted(found.names))
    total = sum(file.stat().st_size for file in {path, *beside})
    if total > MAX_NETWORK_BYTES:
        raise WeightsUnusableError(
            f"the network and its weights have {total:,} bytes, and at most "
            f"{MAX_NETWORK_BYTES:,} are read ({path})"
        )
    return beside


class _NoOnnxError(Exception):
    """Bytes are no message, or contain an unsupported field."""


class _Found:
    def __init__(self) -> None:
        self.names: set[str] = set()
        self.fields = 0
        self.numbers = 0
        """Bytes of tensor data whose size in memory equals that in the file."""


_UNDER: Final[Mapping[str, Mapping[int, str]]] = {
    "model": {7: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node", 11: "attribute"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {
        5: "tensor",
        6: "graph",
        10: "tensor",
        11: "graph",
        22: "sparse",
        23: "sparse",
    },
    "tensor": {4: "numbers", 9: "numbers", 10: "numbers", 13: "external"},
    "external": {},
}
"""Messages of onnx.proto, and the message type of each followed field."""

_DEPTH: Final = 64
"""Largest nesting of graphs; the runtime's own reader follows a hundred messages."""

_FIELDS: Final = 1 << 20
"""Largest number of followed fields, which takes seconds; a network of a thousand operators has
20,000."""


def _walk(data: mmap.mmap, at: int, end: int, kind: str, found: _Found, depth: int = 0) -> None:
    """Follow one message of this kind between two offsets."""
    if depth > _DEPTH:
        raise _NoOnnxError("its graphs lie too deep in one another")
    under = _UNDER[kind]
    texts: dict[int, set[bytes]] = {1: set(), 2: set()}
    for field, start, stop in _fields(data, at, end):
        found.fields += 1
        if found.fields > _FIELDS:
            raise _NoOnnxError(f"its graph has more than {_FIELDS:,} entries")
        below = under.get(field)
        if kind == "external" and field in texts:
            texts[field].add(data[start : min(stop, start + _NAME_BYTES + 1)])
        elif below == "numbers":
            found.numbers += stop - start
        elif below == "sparse":
            raise _NoOnnxError("it holds a sparse tensor, of which the file's size says nothing")
        elif below is not None:
            _walk(data, start, stop, below, found, depth + 1)
    if b"location" in texts[1]:
        found.names.update(map(_name, texts[2]))


_NAME_BYTES: Final = 1024


def _name(text: bytes) -> str:
    try:
        name = text.decode("utf-8")
    except UnicodeDecodeError:
        name = ""
    if not name or len(text) > _NAME_BYTES or not name.isprintable():
        raise _NoOnnxError(f"the name of a file of weights is none: {text[:60]!r}")
    return name


def _fields(data: mmap.mmap, at: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield number, start and end of each field; start and end of a number are equal."""
    while at < end:
        tag, at = _varint(data, at, end)
        field, wire = tag >> 3, tag & 7
        if not field:
            raise _NoOnnxError("it is damaged or of another kind")
        start = stop = at
        if wire == 0:
            _, at = _varint(data, at, end)
        elif wire in (1, 5):
            at += 8 if wire == 1 else 4
        elif wire == 2:
            length, start = _varint(data, at, end)
            stop = at = start + length
        else:
            raise _NoOnnxError("it is damaged or of another kind")
        if at > end:
            raise _NoOnnxError("it is cut off or of another kind")
        yield field, start, stop


def _varint(data: mmap.mmap, at: int, end: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= end:
            raise _NoOnnxError("it is cut off or of another kind")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise _NoOnnxError("it is damaged or of another kind")


def _beside(name: str, path: Path) -> Path:
    """Find an external data file, in the folder of the network or below it."""
    folder = real_path(path.parent)
    given = Path(name)
    if given.is_absolute() or ".." in given.parts:
        raise WeightsUnusableError(
            f"the network keeps its weights in {name}: only files beside it are read ({path})"
        )
    try:
        found = (folder / given).resolve(strict=True)
    except (OSError, RuntimeError) as error:
        raise WeightsUnusableError(
            f"the network keeps its weights in {name}: that file must lie beside it ({path})"
        ) from error
    if not found.is_relative_to(folder):
        raise WeightsUnusableError(
            f"the network keeps its weights in {name}, a link that leads out of its folder: put "
            f"the file itself beside the network ({path})"
        )
    open_regular(found, what=f"{name}, which holds weights of {path.name},").close()
    return path.parent / given
