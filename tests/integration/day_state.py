"""The database of a day taken away under its service: deleted, or replaced by a copy of itself."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Final, Literal

from service.store.engine import DATABASE_NAME

Loss = Literal["database deleted", "database replaced"]

_FILES: Final = (DATABASE_NAME, f"{DATABASE_NAME}-wal", f"{DATABASE_NAME}-shm")
_ASIDE: Final = ".aside"


def lose_database(state: Path, how: Loss, *, until_ended: Callable[[], None]) -> None:
    """Take the database away, wait for the end of its service, and bring it back as it was.

    The files are renamed, so that what was acknowledged between the blow and the end of the
    service is in them; a copy that was put in their place is thrown away.

    Args:
        state: Folder of the database.
        how: Whether a copy is put in its place.
        until_ended: Returns when the service has ended, as it must.
    """
    there = [name for name in _FILES if (state / name).exists()]
    copies = [shutil.copyfile(state / name, state / f"{name}.copy") for name in there]
    for name in there:
        (state / name).rename(state / f"{name}{_ASIDE}")
    for name, copy in zip(there, copies, strict=True):
        if how == "database replaced" and not name.endswith("-shm"):
            copy.rename(state / name)
        else:
            copy.unlink()
    try:
        until_ended()
    finally:
        for name in _FILES:
            (state / name).unlink(missing_ok=True)
        for name in there:
            (state / f"{name}{_ASIDE}").rename(state / name)
