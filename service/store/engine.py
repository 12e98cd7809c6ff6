"""Database engine and transactions; the only module that depends on the kind of server."""

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Final

import structlog
from sqlalchemy import Connection, Engine, inspect

from schemas.errors import CounterpointError
from service.errors import StatementFailedError, StateUnusableError
from service.store.faults import RAISED, StoreUnavailableError, fault_of, names_no_database
from service.store.file_check import check_pages, require_whole, traces_of_loss
from service.store.file_watch import FileWatch
from service.store.grouped_writes import GroupedWrites, Result
from service.store.lineage import (
    RESTORED,
    Lineage,
    changes,
    count_write,
    give_incarnation,
    read_lineage,
    take_term,
)
from service.store.migrations import migrate, require_current
from service.store.postgres import PATIENCE, OpenSockets, postgres_engine
from service.store.sqlite import READS, sqlite_engine
from service.store.tables import METADATA
from service.store.transaction_effects import StoreObserver, begin_effects

__all__ = [
    "DATABASE_NAME",
    "Store",
    "StoreUnavailableError",
    "open_store",
    "open_store_at",
    "open_store_to_read",
    "postgres_engine",
]

log = structlog.get_logger(__name__)

DATABASE_NAME: Final = "counterpoint.sqlite"
_POOL_LOG: Final = "sqlalchemy.pool"
"""Logger of a connection that could not be reset: it repeats an error as a traceback."""

_GONE_PATIENCE_S: Final = 10.0
"""Time after which a server that reports a missing database is believed, seconds."""


class Store:
    """One open database.

    Writers take turns here, so that a process never competes with itself for SQLite's only write
    lock; readers take no lock and see the last commit. Both check that the database is still the
    one that was opened, and that it has not returned to an earlier state.

    Attributes:
        name: Name of the database for errors, without a password.
    """

    def __init__(
        self,
        engine: Engine,
        *,
        name: str,
        reader: Mapping[str, object],
        watch: FileWatch | None = None,
        sockets: OpenSockets | None = None,
    ) -> None:
        """Make a store from an engine.

        Args:
            engine: On the database.
            name: Name of the database, for errors.
            reader: Execution options of transactions that only read.
            watch: Watch of its files; None: it has none here.
            sockets: Sockets of its connections; None: it has none.
        """
        logging.getLogger(_POOL_LOG).setLevel(logging.CRITICAL)
        self._engine, self._reader = engine, engine.execution_options(**reader)
        self.name = name
        self._watch = watch
        self._writer = threading.Lock()
        self._observer: StoreObserver | None = None
        self._groups = GroupedWrites(self.writing)
        self._cannot_write = ""
        self._lineage: Lineage | None = None
        self._lost: StateUnusableError | None = None
        """Cause for which the database that was opened is lost; None: it is not."""
        self._sockets = sockets
        self._missing_since_s: float | None = None
        self._damaged: set[str] = set()

    @property
    def cannot_write(self) -> str:
        """Error of the last writing transaction; empty: writing works."""
        return self._cannot_write

    @property
    def term(self) -> int:
        """Term of the database under which this store writes; 0 on SQLite, which needs none."""
        return 0 if self._lineage is None else self._lineage.term

    def shut(self) -> None:
        """End every wait for a PostgreSQL server; further use connects again."""
        if self._sockets is not None:
            self._sockets.shut()

    def observe(self, observer: StoreObserver) -> None:
        """Add an observer of all further transactions."""
        self._observer = observer

    @contextmanager
    def writing(self, *, proves: bool = False) -> Iterator[Connection]:
        """Begin a durable transaction: on disk when the block is left, undone if it raises.

        Args:
            proves: Write something in any case. A transaction without changes needs no disk, and
                would succeed on a full one; so after a failure each transaction writes.

        Raises:
            StoreUnavailableError: If the database cannot take it now.
            StatementFailedError: If it can never take the statements of the block.
            StateUnusableError: If it is damaged, or not the one that was opened.
        """
        with self._writer:
            try:
                with self._translated(), self._watched(), self._engine.begin() as connection:
                    effects = begin_effects(connection)
                    before = changes(connection)
                    yield connection
                    always = proves or bool(self._cannot_write)
                    lineage = count_write(connection, changed_before=before, always=always)
                    if lineage is not None:
                        lineage.require_not_before(self._lineage, name=self.name)
            except (StoreUnavailableError, StateUnusableError) as error:
                self._cannot_write = str(error)
                raise
            self._cannot_write = ""
            self._lineage = lineage or self._lineage
        if self._observer is not None:
            self._observer.on_effects(effects)

    def write(self, work: Callable[[Connection], Result]) -> Result:
        """Run a short write in a transaction shared with other threads; it is on disk on return.

        Args:
            work: Function of a transaction; it may be called again in another, if the first was
                undone.

        Raises:
            StoreUnavailableError: If the database cannot take it now.
            StatementFailedError: If it can never take the statements of the work.
            StateUnusableError: If it is damaged, or not the one that was opened.
        """
        return self._groups.do(work)

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Begin a reading transaction with a consistent view of the last commit.

        Raises:
            StoreUnavailableError: If the database does not answer now.
            StatementFailedError: If it can never answer the statements of the block.
            StateUnusableError: If it is damaged, or not the one that was opened.
        """
        with self._translated():
            if self._watch is not None:
                self._watch.look()
            known = self._lineage  # before the view begins: it must not be older
            with self._reader.begin() as connection:
                if known is not None:
                    read_lineage(connection, self.name).require_not_before(known, name=self.name)
                yield connection

    def bring_up_to_date(self) -> None:
        """Run the pending migrations, and watch the database from now on.

        Raises:
            StateUnusableError: If a newer version wrote it, or it is damaged.
            StoreUnavailableError: If it cannot take them now.
        """
        with self._writer, self._translated(), self._engine.begin() as connection:
            migrate(connection, name=self.name)
            give_incarnation(connection)
            if connection.dialect.name != "sqlite":  # the lock of its folder suffices there
                take_term(connection)
            if self._watch is not None:
                self._watch.begin(connection)
            lineage = read_lineage(connection, self.name)
        if self._watch is not None:
            self._watch.after_write()
        self._lineage = lineage

    def note_damaged(self, scene_id: str, problem: str) -> None:
        """Log and count a damaged record, once, however often it is read."""
        if scene_id not in self._damaged:
            self._damaged.add(scene_id)
            log.error("stored record is damaged, not shown", scene_id=scene_id, problem=problem)
            if self._observer is not None:
                self._observer.on_damaged_record()

    def close(self) -> None:
        """Close every connection."""
        self._engine.dispose()
        if self._watch is not None:
            self._watch.close()

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """Check the files before a transaction, and after its commit."""
        if self._watch is None:
            yield
            return
        self._watch.before_write()
        try:
            yield
        except BaseException:
            self._watch.after_failure()
            raise
        self._watch.after_write()

    @contextmanager
    def _translated(self) -> Iterator[None]:
        """Translate errors of the database, and classify them as transient or permanent."""
        if self._lost is not None:
            raise type(self._lost)(str(self._lost))
        driver = self._engine.dialect.loaded_dbapi
        try:
            yield
        except (*RAISED, driver.Error) as error:
            fault = fault_of(error, driver, name=self.name)
            if isinstance(fault, StoreUnavailableError) and names_no_database(error):
                fault = self._missing(fault)
            elif isinstance(fault, StatementFailedError) and not self._is_ours():
                what = "its tables are gone"
                fault = StateUnusableError(RESTORED.format(name=self.name, what=what))
            elif isinstance(fault, StateUnusableError):
                fault = self._lost_file() or fault
            if self._observer is not None and not isinstance(fault, StatementFailedError):
                self._observer.on_database_error()
            self._note(fault)
            raise fault from error
        except StateUnusableError as error:
            self._note(error)
            raise
        self._missing_since_s = None

    def _note(self, fault: CounterpointError) -> None:
        """Keep the error of a lost database, since it is never trusted again before a restart."""
        if isinstance(fault, StateUnusableError) and self._lineage is not None:
            self._lost = fault

    def _lost_file(self) -> StateUnusableError | None:
        """Return what happened to a file that the driver only calls damaged, where it is known."""
        try:
            if self._watch is not None:
                self._watch.look()
        except StateUnusableError as error:
            return error
        except StoreUnavailableError:
            return None
        return None

    def _missing(self, fault: StoreUnavailableError) -> CounterpointError:
        now_s = time.monotonic()
        self._missing_since_s = self._missing_since_s or now_s
        if self._lineage is None or now_s - self._missing_since_s < _GONE_PATIENCE_S:
            return fault
        return StateUnusableError(
            f"the database was dropped while the service ran ({self.name}); nothing is "
            "acknowledged any more: restore it from a copy, and start the service again"
        )

    def _is_ours(self) -> bool:
        """Return true if all tables of this program exist, checked in a separate transaction."""
        if self._lineage is None:
            return True
        try:
            with self._reader.begin() as connection:
                return METADATA.tables.keys() <= set(inspect(connection).get_table_names())
        except (*RAISED, self._engine.dialect.loaded_dbapi.Error) as error:
            fault = fault_of(error, self._engine.dialect.loaded_dbapi, name=self.name)
            return not isinstance(fault, StatementFailedError)


def has_database(folder: Path) -> bool:
    """Return true if a state folder has a database.

    Raises:
        StateUnusableError: If the state is no folder, or its database is no file.
    """
    path = folder / DATABASE_NAME
    try:
        if folder.exists() and not folder.is_dir():
            raise StateUnusableError(f"the state is a file, not a folder: {folder}")
        if path.exists() and not path.is_file():
            raise StateUnusableError(f"the database is no regular file: {path}")
        return path.exists()
    except (OSError, RuntimeError) as error:  # a loop of links, or a folder that may not be read
        raise StateUnusableError(f"the state folder cannot be read: {error}") from error


def open_store(folder: Path) -> Store:
    """Open the database of a state folder for writing; create or migrate it as needed.

    Raises:
        StateUnusableError: If a newer version wrote it, it is no database, or a damaged one.
        StoreUnavailableError: If it is locked or the disk is full.
    """
    path = folder / DATABASE_NAME
    require_whole(path)
    if loss := traces_of_loss(path):
        log.warning("the state begins with an empty database", problem=loss, state=str(folder))
    if path.exists():
        with closing(_sqlite(path, read_only=True)) as store, store.reading() as connection:
            check_pages(connection, path)
    return _opened(_sqlite(path, watch=FileWatch(path)), name=str(path))


def open_store_to_read(folder: Path) -> Store:
    """Open the database of a state folder for reading only, with or without a running service.

    Raises:
        StateUnusableError: If there is none, or its version is not this program's.
    """
    path = folder / DATABASE_NAME
    if not has_database(folder):
        advice = traces_of_loss(path) or "name the folder of a run with --state"
        raise StateUnusableError(f"no state to read: {path} does not exist; {advice}")
    require_whole(path)
    return _opened(_sqlite(path, read_only=True), name=str(path), read_only=True)


def open_store_at(url: str, *, read_only: bool = False, session_name: str = "") -> Store:
    """Open a PostgreSQL database, migrated as needed, or for reading only.

    Opening it for writing begins a new term: whatever was opened before may write no longer.

    Args:
        url: URL of the database, as SQLAlchemy takes it.
        read_only: Open it for reading only.
        session_name: Name of its sessions, by which a standby ends those of a frozen service.

    Raises:
        StateUnusableError: If a newer version wrote it, its driver is not installed, or it may only
            be read and is not of this version.
        StoreUnavailableError: If the server does not answer.
    """
    named = {"application_name": session_name} if session_name else {}
    engine = postgres_engine(url, pool_pre_ping=True, connect_args={**PATIENCE, **named})
    name = engine.url.render_as_string(hide_password=True)
    # Several queries of one view see one commit, as they do on SQLite.
    return _opened(
        Store(
            engine,
            name=name,
            reader={"isolation_level": "REPEATABLE READ"},
            sockets=OpenSockets(engine),
        ),
        name=name,
        read_only=read_only,
    )


def _opened(store: Store, *, name: str, read_only: bool = False) -> Store:
    try:
        if read_only:
            with store.reading() as connection:
                require_current(connection, name=name)
        else:
            store.bring_up_to_date()
    except BaseException:
        store.close()
        raise
    return store


def _sqlite(path: Path, *, read_only: bool = False, watch: FileWatch | None = None) -> Store:
    engine = sqlite_engine(path, read_only=read_only)
    return Store(engine, name=str(path), reader={READS: True}, watch=watch)
