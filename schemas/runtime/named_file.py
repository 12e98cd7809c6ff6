"""Bounded reading of files that a user names; only regular files are accepted.

A pipe may never begin or end, and a device has no end: a command that opens one hangs.
"""

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path
from typing import Final

MAX_TEXT_BYTES: Final = 4_000_000
"""Bytes of a settings file, an adapter, a profile or a calibration; real ones have kilobytes."""


def open_named_file(path: Path) -> BufferedReader:
    """Open a file whose path a user gave, for reading.

    Args:
        path: What was named; links are followed.

    Raises:
        OSError: If it cannot be opened or is no regular file; `strerror` says which, as the end of
            a sentence.
    """
    try:
        # A pipe without a writer would be waited for; O_NONBLOCK means nothing to a file.
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except ValueError:  # a NUL character, or half of a surrogate pair
        raise OSError(errno.EINVAL, "no path can have these characters", str(path)) from None
    try:
        _need_regular(os.fstat(file).st_mode, path)
    except OSError:
        os.close(file)
        raise
    return os.fdopen(file, "rb")


def read_named_file(path: Path, *, at_most: int = MAX_TEXT_BYTES) -> bytes:
    """Read a file whose path a user gave.

    Args:
        path: What was named; links are followed.
        at_most: Bytes that it may have.

    Raises:
        OSError: As `open_named_file`, or if it is larger.
    """
    with open_named_file(path) as opened:
        content = opened.read(at_most + 1)
    if len(content) > at_most:
        raise OSError(errno.EFBIG, f"larger than {at_most / 1e6:g} MB", str(path))
    return content


def _need_regular(mode: int, path: Path) -> None:
    """Refuse what is no regular file.

    Args:
        mode: As `stat` gives it.
        path: For the error.

    Raises:
        OSError: If it is a folder, a pipe, a socket or a device.
    """
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "a folder, not a regular file", str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "a pipe or a device, not a regular file", str(path))
