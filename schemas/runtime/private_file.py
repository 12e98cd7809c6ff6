"""Files with secrets: read only if other users of the machine cannot read them."""

import errno
import os
import stat
from pathlib import Path
from typing import Final

from schemas.errors import PermanentError
from schemas.runtime.named_file import read_named_file

MAX_SECRET_BYTES: Final = 1_000_000
"""Bytes of a file of keys or tokens; real ones have kilobytes."""


def need_private(path: Path, *, what: str) -> None:
    """Refuse a file of secrets that every user of this machine can read.

    Args:
        path: The file.
        what: Name of the setting, for the message.

    Raises:
        PermanentError: If it is missing, or others may read it.
    """
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise PermanentError(f"{what}: cannot read the file: {reason} ({path})") from None
    if mode & stat.S_IROTH:
        raise PermanentError(
            f"{what}: every user of this machine can read this secret; chmod o-r it ({path})"
        )


def read_private(path: Path, *, what: str) -> bytes:
    """Read a file of secrets.

    Args:
        path: The file.
        what: Name of the setting, for the message.

    Raises:
        PermanentError: If it cannot be read, or others may read it.
    """
    need_private(path, what=what)
    try:
        return read_named_file(path, at_most=MAX_SECRET_BYTES)
    except OSError as error:
        raise PermanentError(f"{what}: cannot read the file: {error.strerror} ({path})") from None


def write_private(path: Path, content: bytes) -> None:
    """Write a file that only its owner can read; a regular file that is there is replaced at once.

    Raises:
        OSError: If it cannot be written, or anything but a regular file is there.
    """
    if not path.name:
        raise IsADirectoryError(errno.EISDIR, "a folder, not a file", str(path))
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise FileExistsError(errno.EEXIST, "a link, a pipe or a device is there", str(path))
    grown = path.with_name(f".{path.name}.part")
    grown.unlink(missing_ok=True)
    made = os.open(grown, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(made, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    grown.replace(path)
