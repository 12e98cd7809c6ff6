"""Safe opening of network files: regular files of a bounded size, checked before they are read."""

import os
from pathlib import Path
from typing import BinaryIO, Final

from schemas.runtime.named_file import open_named_file
from workers.checkpoints.errors import WeightsUnusableError

MAX_NETWORK_BYTES: Final = 2 << 30
"""Largest size of all files of one network, or of one checkpoint, bytes. It is the limit of
protobuf, and ten times the largest published lidar network. While a network is opened, its numbers
are in memory once or twice."""

MAX_STRUCTURE_BYTES: Final = 32 << 20
"""Largest size of the graph, code and names in a network's file, bytes. They grow up to thirtyfold
when parsed; the networks of the method have less than 1 MiB."""

MAX_TEXT_BYTES: Final = 1 << 20
"""Largest adapter, profile or card, bytes: texts of a few KiB."""

_CHUNK: Final = 1 << 20


def open_regular(path: Path, *, what: str, most: int = MAX_NETWORK_BYTES) -> BinaryIO:
    """Open a file for reading, if it can be a network's file.

    Args:
        path: Its path; a device or a pipe does not block.
        what: Its kind, for errors, with the article.
        most: Largest size, bytes.

    Raises:
        WeightsUnusableError: If it cannot be opened, is no regular file, is empty or too large, or
            is a web page or a Git LFS pointer.
    """
    try:
        file = open_named_file(path)
    except OSError as error:
        raise WeightsUnusableError(f"cannot read {what}: {error.strerror} ({path})") from error
    try:
        _check(file, path, what=what, most=most)
    except BaseException:
        file.close()
        raise
    return file


def read_regular(path: Path, *, what: str, most: int = MAX_NETWORK_BYTES) -> bytes:
    """Read a whole file under the checks of `open_regular`, even if it grows meanwhile.

    Raises:
        WeightsUnusableError: As `open_regular`, or if reading fails.
    """
    with open_regular(path, what=what, most=most) as file:
        try:
            return file.read(os.fstat(file.fileno()).st_size)
        except OSError as error:
            raise WeightsUnusableError(f"cannot read {what}: {error.strerror} ({path})") from error


def _check(file: BinaryIO, path: Path, *, what: str, most: int) -> None:
    size = os.fstat(file.fileno()).st_size
    if not size:
        raise WeightsUnusableError(f"{what} is empty ({path})")
    if size > most:
        raise WeightsUnusableError(
            f"{what} has {size:,} bytes, and at most {most:,} are read ({path})"
        )
    start = file.read(256).lstrip().lower()
    file.seek(0)
    if start.startswith((b"<!doctype", b"<html", b"<?xml")):
        raise WeightsUnusableError(f"{what} is a web page here; download the file itself ({path})")
    if start.startswith(b"version https://git-lfs"):
        raise WeightsUnusableError(
            f"{what} is a pointer of Git LFS here; fetch the file itself with git lfs pull ({path})"
        )
