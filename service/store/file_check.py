"""Check of a SQLite file before it is opened, which refuses an incomplete one."""

from pathlib import Path
from typing import Final

from sqlalchemy import Connection

from service.errors import StateUnusableError

CHECKED_WHOLE_BYTES: Final = 256 << 20
"""Largest database whose every page is checked at each start, bytes.

4.4 GB with 1,000,000 scenes took 7 s from memory and 54 s from a busy disk, this size takes 0.5 s
and 3 s. In a larger one the scenes, which are nearly all of it, are skipped; `doctor` checks them
as well.
"""

_LARGE: Final = "scenes"

_HEADER_BYTES: Final = 100
_WAL_HEADER_BYTES: Final = 32
_FRAME_HEADER_BYTES: Final = 24


def traces_of_loss(path: Path) -> str:
    """Return traces of a lost database, and what to do; empty: there are none.

    Args:
        path: Path of the database file.
    """
    if path.exists():
        return ""
    journals = [path.with_name(f"{path.name}-{end}") for end in ("wal", "shm")]
    overlays = path.parent / "artifacts"
    left = [file.name for file in journals if file.exists()]
    if overlays.is_dir() and next(overlays.iterdir(), None) is not None:
        left.append("overlays")
    if not left:
        return ""
    return (
        f"a database was here, of which {' and '.join(left)} are left: put a backup in its place; "
        "without one, a run mines everything again and knows no earlier selection"
    )


def require_whole(path: Path) -> None:
    """Check that a file is no empty or truncated database; a missing file is accepted.

    Raises:
        StateUnusableError: If pages are missing that are not in the journal next to it.
    """
    journal = path.with_name(f"{path.name}-wal")
    if not path.exists():
        return
    size = path.stat().st_size
    if size == 0:
        if not journal.exists() or journal.stat().st_size == 0:
            raise _damaged(path, "the file is empty")
        return
    with path.open("rb") as file:
        header = file.read(_HEADER_BYTES)
    if len(header) < _HEADER_BYTES:
        raise _damaged(path, f"the file has {size} bytes")
    page_bytes = int.from_bytes(header[16:18], "big")
    page_bytes = 65_536 if page_bytes == 1 else page_bytes
    pages = int.from_bytes(header[28:32], "big")
    if header[24:28] != header[92:96] or page_bytes < 512:
        return  # the number is of another version, or this is no database: SQLite says so itself
    here = size // page_bytes
    if here < pages:
        missing = set(range(here + 1, pages + 1)) - _pages_in(journal, page_bytes)
        if missing:
            raise _damaged(path, f"{len(missing)} of its {pages} pages are missing")


def check_pages(connection: Connection, path: Path, *, whole: bool = False) -> None:
    """Check the structure of every page, or of all but the scenes in a very large database.

    Args:
        connection: To read from.
        path: Its file.
        whole: Check every page, however long it takes.

    Raises:
        StateUnusableError: If a page is damaged.
    """
    whole = whole or path.stat().st_size <= CHECKED_WHOLE_BYTES
    for look in ("PRAGMA quick_check(1)",) if whole else _looks(connection):
        found = str(connection.exec_driver_sql(look).scalar_one())
        if found != "ok":
            raise _damaged(path, " ".join(found.split()))


def _looks(connection: Connection) -> list[str]:
    tables = connection.exec_driver_sql("SELECT name FROM sqlite_schema WHERE type = 'table'")
    names = set(tables.scalars()) - {_LARGE}
    return [f'PRAGMA quick_check("{name}")' for name in sorted(names)]


def _pages_in(journal: Path, page_bytes: int) -> set[int]:
    """Return the numbers of the pages in the write-ahead log of a database."""
    found: set[int] = set()
    if not journal.exists():
        return found
    with journal.open("rb") as file:
        salts = file.read(_WAL_HEADER_BYTES)[16:24]
        while len(frame := file.read(_FRAME_HEADER_BYTES)) == _FRAME_HEADER_BYTES:
            if frame[8:16] != salts:
                break  # left over from before the log began from its start again
            found.add(int.from_bytes(frame[:4], "big"))
            file.seek(page_bytes, 1)
    return found


def _damaged(path: Path, what: str) -> StateUnusableError:
    return StateUnusableError(
        f"not a database, or a damaged one: {what} ({path}); "
        "restore it from a copy, or name another folder with --state"
    )
