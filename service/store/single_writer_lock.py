"""Single-writer lock of a PostgreSQL database, held by the server while its connection lasts.

A lock on a file keeps a second service from a state folder. A database can be reached from many
machines, each with a folder of its own, so the lock must be in the database.
"""

import time
from contextlib import suppress
from threading import Lock
from types import TracebackType
from typing import Final, Self

import structlog
from sqlalchemy import Connection, Engine, text
from sqlalchemy.exc import DBAPIError, OperationalError
from sqlalchemy.pool import NullPool

from schemas.errors import PermanentError
from service.errors import StateInUseError
from service.store.engine import StoreUnavailableError, postgres_engine

log = structlog.get_logger(__name__)

_LOCK: Final = 0x436E7470
"""First half of PostgreSQL's lock key, of this program; the second is the schema's name."""

_PATIENCE_S: Final = (0.1, 0.2, 0.4, 0.0)
"""Waits between attempts, seconds; the connection of a killed process is gone in a moment."""

_TAKE: Final = text("SELECT pg_try_advisory_lock(:lock, hashtext(current_schema()))")
_HOLDER: Final = text(
    "SELECT application_name, coalesce(host(client_addr), 'a socket')"
    " FROM pg_locks JOIN pg_stat_activity USING (pid)"
    " WHERE locktype = 'advisory' AND classid = :lock AND granted"
    " AND pg_locks.database = (SELECT oid FROM pg_database WHERE datname = current_database())"
)


class DatabaseTakenError(PermanentError):
    """Another service took over the database while our connection was lost."""


class SoleService:
    """Exclusive right to serve a database, within a `with` block.

    The server frees it when our connection ends, for any cause. `check` takes it again after an
    outage of the server; only one of two services gets it.
    """

    def __init__(self, url: str, *, endpoint: str = "") -> None:
        """Take the lock.

        Args:
            url: URL of the database, as SQLAlchemy takes it.
            endpoint: Endpoint of this service, reported to a refused one.

        Raises:
            StateInUseError: If another service holds it; the message names it.
            StoreUnavailableError: If the server does not answer.
        """
        self._endpoint = endpoint
        self._engine = _engine(url)
        self._name = self._engine.url.render_as_string(hide_password=True)
        self._connection: Connection | None = None
        self._one_at_a_time = Lock()
        try:
            self._take()
        except BaseException:
            self.release()
            raise

    def announce(self, endpoint: str) -> None:
        """Publish the endpoint of this service; empty: not yet known."""
        self._endpoint = endpoint
        with self._one_at_a_time, suppress(DBAPIError):  # `check` notices, and tells it again
            if self._connection is not None:
                self._connection.execute(_NAME, {"name": _application_name(endpoint)})

    def check(self) -> None:
        """Check that the lock is still held; take it again after an outage of the server.

        Raises:
            StoreUnavailableError: If the server does not answer now.
            DatabaseTakenError: If another service took it meanwhile.
        """
        with self._one_at_a_time:
            try:
                if self._connection is not None:
                    self._connection.execute(text("SELECT 1"))
                    return
            except DBAPIError as error:
                self._forget()
                log.warning("lock on the database lost, taking it again", problem=_first(error))
            try:
                self._take()
            except StateInUseError as error:
                raise DatabaseTakenError(f"{error}; this one ends") from None
            log.info("lock on the database taken again")

    def release(self) -> None:
        """Release the lock."""
        self._forget()
        self._engine.dispose()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()

    def _take(self) -> None:
        try:
            connection = self._engine.connect()
            self._connection = connection
            connection.execute(_NAME, {"name": _application_name(self._endpoint)})
            for wait_s in _PATIENCE_S:
                if connection.execute(_TAKE, {"lock": _LOCK}).scalar_one():
                    return
                time.sleep(wait_s)
            holder = connection.execute(_HOLDER, {"lock": _LOCK}).first()
        except OperationalError as error:
            self._forget()
            raise StoreUnavailableError(
                f"cannot use the database: {_first(error)} ({self._name}); "
                "nothing acknowledged is lost, try again when that is fixed"
            ) from error
        self._forget()
        name, where = holder if holder is not None else ("", "an unknown address")
        endpoint = str(name).partition(" ")[2]
        at = f" at {endpoint}" if endpoint else ""
        raise StateInUseError(
            f"a service already holds this database: one{at} connected from {where} ({self._name})"
            + (f"; --connect {endpoint}" if endpoint else "")
        )

    def _forget(self) -> None:
        if self._connection is not None:
            with suppress(DBAPIError):  # a connection that is broken cannot be ended in order
                self._connection.close()
            self._connection = None


_KEEPALIVE: Final = " ".join(
    f"-c tcp_keepalives_{name}={number}"
    for name, number in (("idle", 10), ("interval", 5), ("count", 3))
)
"""TCP keepalive of the server, by which it notices a lost machine within 30 s. Its default takes
hours, in which no other service could start.
"""

_NAME: Final = text("SELECT set_config('application_name', :name, false)")


def _application_name(endpoint: str) -> str:
    return f"counterpoint {endpoint}".strip()[:63]  # PostgreSQL keeps no more


def _engine(url: str) -> Engine:
    return postgres_engine(
        url,
        poolclass=NullPool,
        isolation_level="AUTOCOMMIT",
        connect_args={"connect_timeout": 10, "options": _KEEPALIVE},
    )


def _first(error: DBAPIError) -> str:
    """Keep the first line of the driver's message, since the rest repeats the query."""
    return str(error.orig).splitlines()[0] if str(error.orig) else type(error.orig).__name__
