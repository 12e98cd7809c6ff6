"""Watch over the files of an open SQLite database, so that no write to a lost one is acknowledged.

SQLite goes on writing to a file that has been deleted or moved away, and reports success. Such
writes would be missing at the next start.
"""

import os
import struct
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sqlalchemy import Connection

from service.errors import StateUnusableError
from service.store.faults import StoreUnavailableError

_WRITTEN_BY_US: Final = ("-wal", "-shm")
"""Suffixes of files that SQLite keeps next to the database while a connection is open."""

_CHECKPOINTED: Final = struct.Struct("=8s56xI28xI")
"""Layout of the WAL index from byte 32: the salt of the journal, how many of its frames checkpoints
have copied into the database, and how many they began to copy (sqlite.org/walformat.html, 2.2).
"""

_CHECKPOINTED_AT: Final = 32

_STAMP: Final = "SELECT rootpage FROM sqlite_schema WHERE name = 'write_proof'"


@dataclass(frozen=True, slots=True)
class _Seen:
    """Last known state of one file.

    Attributes:
        identity: Device and inode.
        size: Bytes. No file shrinks while it is open.
        written_ns: Time of the last change of its content, nanoseconds.
    """

    identity: tuple[int, int]
    size: int
    written_ns: int


class FileWatch:
    """State of a database's files at the end of our last transaction.

    Called under the writer's lock, except `look`. The main file is written by nothing but the
    checkpoints within our own transactions.
    """

    def __init__(self, path: Path) -> None:
        """Keep the path of the database; nothing is watched before `begin`."""
        self._path = path
        self._others = tuple(path.with_name(path.name + suffix) for suffix in _WRITTEN_BY_US)
        self._seen: dict[Path, _Seen] = {}
        self._file = self._index = -1
        self._page_bytes = 0
        self._pages: tuple[int, ...] = ()
        self._stamp = b""
        self._checkpoint = (b"", 0, 0)

    def begin(self, connection: Connection) -> None:
        """Record the current files as those of this connection, and watch them from now on.

        Args:
            connection: In a transaction, so that all of its files exist.
        """
        self._page_bytes = connection.exec_driver_sql("PRAGMA page_size").scalar_one()
        self._pages = (1, connection.exec_driver_sql(_STAMP).scalar_one())
        self._file = os.open(self._path, os.O_RDONLY | os.O_CLOEXEC)
        self._index = os.open(self._others[-1], os.O_RDONLY | os.O_CLOEXEC)
        self._seen = {path: _seen(path) for path in (self._path, *self._others)}
        self._stamp, self._checkpoint = self._read_stamp(), self._read_checkpoint()

    def look(self) -> None:
        """Check that the files are still the open ones, and none was truncated.

        Raises:
            StateUnusableError: If one was deleted, replaced or truncated.
            StoreUnavailableError: If the file system does not answer now.
        """
        for path, before in tuple(self._seen.items()):
            self._require_same(path, before, _seen(path))

    def before_write(self) -> None:
        """Check the files before a transaction, and that no other process wrote the main file.

        Raises:
            StateUnusableError: If a file was deleted, replaced, truncated or overwritten.
            StoreUnavailableError: If the file system does not answer now.
        """
        self.look()
        if not self._seen:
            return
        now = _seen(self._path)
        if now != self._seen[self._path]:
            self._require_only_touched()
            self._seen[self._path] = now
        self._checkpoint = self._read_checkpoint()

    def after_write(self) -> None:
        """Check the files after the commit, and record their new state.

        A commit writes to the journal. The main file changes only in a checkpoint, which the WAL
        index records; any other change of it comes from elsewhere.

        Raises:
            StateUnusableError: If a file was deleted, replaced, truncated or overwritten meanwhile.
            StoreUnavailableError: If the file system does not answer now.
        """
        for path, before in tuple(self._seen.items()):
            now = _seen(path)
            self._require_same(path, before, now)
            if now == before:
                continue
            self._seen[path] = now
            if path == self._path:
                self._take_stamp()

    def after_failure(self) -> None:
        """Record the state of the main file after a transaction that was undone."""
        if self._seen:
            with suppress(StoreUnavailableError, StateUnusableError):
                now = _seen(self._path)
                if now.identity == self._seen[self._path].identity:
                    self._seen[self._path] = now
                    self._take_stamp()

    def close(self) -> None:
        """Stop watching; call it after the last connection is closed.

        When a process closes any descriptor of a file, the kernel drops all of its locks on that
        file, including SQLite's; so this descriptor is opened once.
        """
        self._seen = {}
        for opened in (self._file, self._index):
            if opened >= 0:
                os.close(opened)
        self._file = self._index = -1

    def _require_same(self, path: Path, before: _Seen, now: _Seen) -> None:
        if now.identity != before.identity:
            raise _unusable(path, "was replaced by another file")
        if now.size < before.size:
            raise _unusable(path, f"was cut from {before.size} to {now.size} bytes")

    def _take_stamp(self) -> None:
        """Record the current main file, if a checkpoint wrote it since the transaction began."""
        checkpoint = self._read_checkpoint()
        if checkpoint == self._checkpoint:
            self._require_only_touched()
        self._stamp, self._checkpoint = self._read_stamp(), checkpoint

    def _require_only_touched(self) -> None:
        if self._read_stamp() != self._stamp:
            raise _unusable(self._path, "was overwritten by another program")

    def _read_checkpoint(self) -> tuple[bytes, int, int]:
        """Read the progress of checkpoints, which only a checkpoint changes."""
        found = os.pread(self._index, _CHECKPOINTED.size, _CHECKPOINTED_AT)
        if len(found) < _CHECKPOINTED.size:
            raise _unusable(self._others[-1], "was cut")
        salt, copied, attempted = _CHECKPOINTED.unpack(found)
        return (salt if attempted else b"", copied, attempted)

    def _read_stamp(self) -> bytes:
        """Read the pages that differ between any two copies: the header, and the write count."""
        size = self._page_bytes
        return b"".join(os.pread(self._file, size, (page - 1) * size) for page in self._pages)


def _seen(path: Path) -> _Seen:
    try:
        found = path.stat()
    except FileNotFoundError:
        raise _unusable(path, "was deleted or moved away") from None
    except OSError as error:
        raise StoreUnavailableError(
            f"cannot use the database: {error.strerror} ({path}); "
            "nothing acknowledged is lost, try again when that is fixed"
        ) from error
    return _Seen((found.st_dev, found.st_ino), found.st_size, found.st_mtime_ns)


def _unusable(path: Path, what: str) -> StateUnusableError:
    return StateUnusableError(
        f"the database {what} while the service ran: {path}; nothing is acknowledged any more: end "
        "whatever did that, restore the database from a copy, without its -wal and -shm, and start "
        "the service again"
    )
