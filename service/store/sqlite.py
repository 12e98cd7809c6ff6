"""Connections to SQLite: durable, with one writer at a time that takes its lock at once."""

import os
import sqlite3
from functools import partial
from pathlib import Path
from typing import Final
from urllib.parse import quote

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.pool import QueuePool

from schemas.runtime.real_path import real_path

BUSY_TIMEOUT_MS: Final = 10_000
"""Longest wait of a writer for a reader that holds up a checkpoint, milliseconds."""

CACHE_KIB: Final = 512
"""Page cache of each of up to fifteen connections, KiB; the kernel caches the file as well."""

READS: Final = "counterpoint_reads"
"""Execution option of transactions that only read."""

_text: Final = partial(str, encoding="utf-8", errors="replace")
"""Decoder of text that accepts a damaged byte; the digest of the record detects it."""


def sqlite_engine(path: Path, *, read_only: bool = False) -> Engine:
    """Make an engine on an SQLite file; it connects on first use."""
    # A URI, since only that can say read-only; percent-encoded, since a folder may hold `?` or `#`.
    uri = f"file:{quote(str(real_path(path)))}?mode={'ro' if read_only else 'rwc'}"
    journal = path.with_name(f"{path.name}-wal")
    if read_only and not os.access(path.parent, os.W_OK) and not journal.exists():
        uri += "&immutable=1"  # no process writes, and SQLite may not make the files of its WAL

    def connect() -> sqlite3.Connection:
        # The driver's own transactions begin late and never IMMEDIATE: switched off. The pool hands
        # a connection to one thread at a time, whichever that is.
        connection = sqlite3.connect(uri, uri=True, isolation_level=None, check_same_thread=False)
        try:
            connection.execute(f"PRAGMA busy_timeout={BUSY_TIMEOUT_MS}")
            connection.execute("PRAGMA foreign_keys=ON")
            connection.text_factory = _text
            connection.execute(f"PRAGMA cache_size=-{CACHE_KIB}")
            if not read_only:
                connection.execute("PRAGMA journal_mode=WAL")
                connection.execute("PRAGMA synchronous=FULL")
        except sqlite3.Error:
            connection.close()
            raise
        return connection

    engine = create_engine("sqlite://", creator=connect, poolclass=QueuePool)

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        # A transaction that reads first and writes later may find itself locked out: take the
        # write lock at once where writing is meant.
        reads = read_only or connection.get_execution_options().get(READS, False)
        connection.exec_driver_sql("BEGIN" if reads else "BEGIN IMMEDIATE")

    return engine
