"""Opens the files of networks: regular ones of a bounded size, checked before they are read."""

import os
from pathlib import Path
from typing import BinaryIO, Final

from schemas.runtime.named_file import open_named_file
from workers.checkpoints.errors import WeightsUnusableError

MAX_NETWORK_BYTES: Final = 2 << 30
"""All files of one network, or one checkpoint: what protobuf can hold, and ten times the largest
network that is published for lidar. Its numbers are held once or twice while it is opened."""

MAX_STRUCTURE_BYTES: Final = 32 << 20
"""What is not numbers in a network's file: graph, code, names. It grows up to thirtyfold as it is
parsed; the networks of the method have less than 1 MiB."""

MAX_TEXT_BYTES: Final = 1 << 20
"""An adapter, a profile, a card: text of a few KiB."""

_CHUNK: Final = 1 << 20


def open_regular(path: Path, *, what: str, most: int = MAX_NETWORK_BYTES) -> BinaryIO:
    """Open a file for reading, unless it is none that could be meant.

    Args:
        path: Its path; a device or a pipe is not waited for.
        what: What it should be, for errors, with its article.
        most: Bytes it may have.

    Raises:
        WeightsUnusableError: If it cannot be opened, is no regular file, is empty or too large, or
            is a web page or the pointer that Git LFS leaves in a file's place.
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
    """Read a whole file, as `open_regular` takes it; also if it grows meanwhile.

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
