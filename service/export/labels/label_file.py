"""Reading a file of labels that another program wrote, and the errors about it."""

import json
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from service.errors import UsageError

MAX_BYTES: Final = 2**31
"""Bytes of a file at most; the labels of all points of a scene have a hundredth of it as text."""


def read_bytes(path: Path) -> bytes:
    """Read a file.

    Raises:
        UsageError: If it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise UsageError(f"cannot read labels: {error.strerror} ({path})") from None


def read_json(path: Path, *, what: str) -> Any:
    """Read a JSON file; the last ones are remembered, since a file has all frames of a scene.

    Args:
        path: The file.
        what: What it should be, for the error.

    Raises:
        UsageError: If it cannot be read, or is no JSON.
    """
    try:
        about = path.stat()
        if about.st_size > MAX_BYTES:
            raise UsageError(f"cannot read labels: the {what} exceeds {MAX_BYTES} bytes ({path})")
        return _read(path, about.st_mtime_ns, about.st_size)
    except OSError as error:
        raise UsageError(f"cannot read labels: {error.strerror} ({path})") from None
    except (ValueError, RecursionError) as error:
        raise unlike(what, error, path) from None


@lru_cache(maxsize=4)
def _read(path: Path, _changed_ns: int, _size: int) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def unlike(what: str, why: Exception | str, path: Path, *, frame: int | None = None) -> UsageError:
    """Return the error for a file that is not what it should be, all of it or in one frame."""
    told = why if isinstance(why, str) else f"{type(why).__name__}: {why}"
    if frame is not None:
        told = f"frame {frame}: {told}"
    return UsageError(f"cannot read labels: this is no {what}: {told} ({path})")


def of_another_scene(what: str, why: str, path: Path) -> UsageError:
    """Return the error for a file that belongs to another scene."""
    return UsageError(f"cannot read labels: this {what} is of another scene: {why} ({path})")
