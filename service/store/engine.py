"""Opens the database and hands out transactions: the only file that knows which server it is."""

import os
import sqlite3
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from sqlalchemy import Connection, Engine, create_engine, event, update
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from sqlalchemy.pool import QueuePool

from schemas.errors import TransientError
from service.errors import StateUnusableError
from service.store.effects import StoreObserver, begin_effects
from service.store.grouping import GroupedWrites, Result
from service.store.migrations import migrate, require_current
from service.store.tables import WRITE_PROOF

DATABASE_NAME: Final = "counterpoint.sqlite"
BUSY_TIMEOUT_MS: Final = 10_000
"""A reader of another process may hold up a checkpoint for this long before a writer gives up."""

CACHE_KIB: Final = 512
"""Pages that each connection keeps; fifteen may be open, and the kernel keeps the file as well."""

_READS: Final = "counterpoint_reads"

_PROVE: Final = update(WRITE_PROOF).values(writes=WRITE_PROOF.c.writes + 1)
"""Another value each time: SQLite writes no page that stays the same."""


class StoreUnavailableError(TransientError):
    """The database could not finish a transaction: disk full, locked, or its server is away."""


class Store:
    """One open database.

    Writers wait for each other here, so that a process never competes with itself for SQLite's one
    write lock; readers take part in no lock and see the last commit.

    Attributes:
        name: Which one, for errors; without a password.
    """

    def __init__(self, engine: Engine, *, name: str, reader: Mapping[str, object]) -> None:
        """Take an engine on a database.

        Args:
            engine: On the database.
            name: Which one, for errors.
            reader: Execution options of transactions that only read.
        """
        self._engine, self._reader = engine, engine.execution_options(**reader)
        self.name = name
        self._writer = threading.Lock()
        self._observer: StoreObserver | None = None
        self._groups = GroupedWrites(self.writing)
        self._cannot_write = ""

    @property
    def cannot_write(self) -> str:
        """Why the last transaction that was to write could not; empty: writing works."""
        return self._cannot_write

    def observe(self, observer: StoreObserver) -> None:
        """Tell one observer what happens from now on."""
        self._observer = observer

    @contextmanager
    def writing(self, *, proves: bool = False) -> Iterator[Connection]:
        """One durable transaction: on disk when the block is left, undone if it raises.

        Args:
            proves: Write something in any case. A transaction that finds nothing to change needs no
                disk, and would pass on one that is full; so after a failure each one proves it.

        Raises:
            StoreUnavailableError: If the database cannot take it now.
        """
        with self._writer:
            try:
                with self._said(), self._engine.begin() as connection:
                    effects = begin_effects(connection)
                    yield connection
                    if proves or self._cannot_write:
                        connection.execute(_PROVE)
            except (StoreUnavailableError, StateUnusableError) as error:
                self._cannot_write = str(error)
                raise
            self._cannot_write = ""
        if self._observer is not None:
            self._observer.on_effects(effects)

    def write(self, work: Callable[[Connection], Result]) -> Result:
        """Do a short piece of writing, together with those of other threads; then it is on disk.

        Args:
            work: In a transaction; it may be called again in another, if the first was undone.

        Raises:
            StoreUnavailableError: If the database cannot take it now.
        """
        return self._groups.do(work)

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """One consistent view of the last commit.

        Raises:
            StoreUnavailableError: If the database does not answer now.
        """
        with self._said(), self._reader.begin() as connection:
            yield connection

    def close(self) -> None:
        """Close every connection."""
        self._engine.dispose()

    @contextmanager
    def _said(self) -> Iterator[None]:
        """Say what an error of the database means, and whether it may pass."""
        driver = self._engine.dialect.loaded_dbapi
        try:
            yield
        except (DBAPIError, PoolTimeoutError, driver.Error) as error:
            cause = error.orig if isinstance(error, DBAPIError) else error
            if self._observer is not None:
                self._observer.on_database_error()
            if isinstance(cause, (driver.OperationalError, PoolTimeoutError)) or _may_pass(cause):
                raise StoreUnavailableError(
                    f"cannot use the database: {cause} ({self.name}); "
                    "nothing acknowledged is lost, try again when that is mended"
                ) from error
            if type(cause) is driver.DatabaseError:
                raise StateUnusableError(
                    f"not a database, or a damaged one: {cause} ({self.name}); "
                    "restore it from a copy, or name another folder with --state"
                ) from error
            raise  # the other kinds are wrong queries: ours, not the user's


def _may_pass(cause: object) -> bool:
    """Whether PostgreSQL calls an error internal that is none: the standby took over, or will."""
    return getattr(cause, "sqlstate", None) == _READ_ONLY_SERVER


_READ_ONLY_SERVER: Final = "25006"


def open_store(folder: Path) -> Store:
    """Open the database of a state folder for writing; made, or brought up to date, as needed.

    Raises:
        StateUnusableError: If a newer version wrote it, or it is no database.
        StoreUnavailableError: If it is locked or the disk is full.
    """
    path = folder / DATABASE_NAME
    return _opened(_sqlite(path), name=str(path))


def open_store_to_read(folder: Path) -> Store:
    """Open the database of a state folder for reading only, beside a running service or without.

    Raises:
        StateUnusableError: If there is none, or its version is not this program's.
    """
    path = folder / DATABASE_NAME
    if not path.is_file():
        raise StateUnusableError(
            f"no state to read: {path} does not exist; name the folder of a run with --state"
        )
    return _opened(_sqlite(path, read_only=True), name=str(path), read_only=True)


def open_store_at(url: str, *, read_only: bool = False) -> Store:
    """Open a PostgreSQL database, made up to date as needed, or only to read.

    Raises:
        StateUnusableError: If a newer version wrote it, its driver is not installed, or it may only
            be read and is not of this version.
        StoreUnavailableError: If the server does not answer.
    """
    engine = postgres_engine(url, pool_pre_ping=True)
    name = engine.url.render_as_string(hide_password=True)
    # Several queries of one view see one commit, as they do on SQLite.
    return _opened(
        Store(engine, name=name, reader={"isolation_level": "REPEATABLE READ"}),
        name=name,
        read_only=read_only,
    )


def postgres_engine(url: str, **options: Any) -> Engine:
    """Make an engine on a PostgreSQL; it connects when it is used.

    Raises:
        StateUnusableError: If the driver is not installed.
    """
    try:
        return create_engine(url, **options)
    except ModuleNotFoundError as error:
        raise StateUnusableError(
            f"PostgreSQL needs the extra `postgres`: pip install 'counterpoint[postgres]' ({error})"
        ) from None


def _opened(store: Store, *, name: str, read_only: bool = False) -> Store:
    try:
        if read_only:
            with store.reading() as connection:
                require_current(connection, name=name)
        else:
            with store.writing() as connection:
                migrate(connection, name=name)
    except BaseException:
        store.close()
        raise
    return store


def _sqlite(path: Path, *, read_only: bool = False) -> Store:
    # A URI, since only that can say read-only; percent-encoded, since a folder may hold `?` or `#`.
    uri = f"file:{quote(str(path.resolve()))}?mode={'ro' if read_only else 'rwc'}"
    journal = path.with_name(f"{path.name}-wal")
    if read_only and not os.access(path.parent, os.W_OK) and not journal.exists():
        uri += "&immutable=1"  # nobody writes, and SQLite may not make the files it guards WAL with

    def connect() -> sqlite3.Connection:
        # The driver's own transactions begin late and never IMMEDIATE: switched off. The pool hands
        # a connection to one thread at a time, whichever that is.
        connection = sqlite3.connect(uri, uri=True, isolation_level=None, check_same_thread=False)
        try:
            connection.execute(f"PRAGMA busy_timeout={BUSY_TIMEOUT_MS}")
            connection.execute("PRAGMA foreign_keys=ON")
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
        reads = read_only or connection.get_execution_options().get(_READS, False)
        connection.exec_driver_sql("BEGIN" if reads else "BEGIN IMMEDIATE")

    return Store(engine, name=str(path), reader={_READS: True})
