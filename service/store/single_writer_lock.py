"""Single-writer lock of a PostgreSQL database, held by the server while its connection lasts.

A lock on a file keeps a second service from a state folder. A database can be reached from many
machines, each with a folder of its own, so the lock must be in the database. The lock shows a death
at once; the beats of `service_lease` show a holder that is frozen or cut off.
"""

import time
import uuid
from contextlib import suppress
from threading import Lock
from types import TracebackType
from typing import Final, Self

import structlog
from sqlalchemy import Connection, Engine, text
from sqlalchemy.exc import DBAPIError, OperationalError
from sqlalchemy.pool import NullPool

from service.errors import DatabaseTakenError, StateInUseError
from service.store.faults import StoreUnavailableError
from service.store.postgres import PATIENCE, OpenSockets, postgres_engine
from service.store.service_lease import LOCK, TAKE, beat, named_holder, standbys

log = structlog.get_logger(__name__)

_PATIENCE_S: Final = (0.1, 0.2, 0.4, 0.0)
"""Waits between attempts, seconds; the connection of a killed process is gone in a moment."""


class SoleService:
    """Exclusive right to serve a database, within a `with` block.

    The server frees it when our connection ends, for any cause. `check` takes it again after an
    outage of the server; only one of two services gets it.

    Attributes:
        ident: Name of this holder, the first word of the name of all its sessions.
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
        self.ident = f"counterpoint-{uuid.uuid4().hex[:12]}"
        self._endpoint = endpoint
        self._engine = lock_engine(url)
        self._sockets = OpenSockets(self._engine)
        self._term: int | None = None
        self._lease_s = 0.0
        self._beaten_s = 0.0
        self._standbys = 0
        self._name = self._engine.url.render_as_string(hide_password=True)
        self._connection: Connection | None = None
        self._one_at_a_time = Lock()
        try:
            self._take()
        except BaseException:
            self.release()
            raise

    def begin(self, term: int, *, lease_s: float) -> None:
        """Begin to beat with every `check`.

        Args:
            term: Term of the opened database.
            lease_s: Silence after which a standby may take over, seconds.
        """
        self._term, self._lease_s, self._beaten_s = term, lease_s, time.monotonic()
        self.check()

    def require_heard(self) -> None:
        """Refuse to serve on when a standby may have taken over without this service's knowledge.

        Raises:
            DatabaseTakenError: If the database has taken no beat for the time of the lease.
        """
        silent_s = time.monotonic() - self._beaten_s
        if silent_s > self._lease_s:
            raise DatabaseTakenError(
                f"the database has not heard this service for {silent_s:.0f} s, and a standby may "
                f"serve it now ({self._name}); this one serves no longer"
            )

    def standbys(self) -> int:
        """Return the services that stood by at the last check."""
        return self._standbys

    def shut(self) -> None:
        """End every wait for the server; further use connects again."""
        self._sockets.shut()

    def announce(self, endpoint: str) -> None:
        """Publish the endpoint of this service; empty: not yet known."""
        self._endpoint = endpoint
        with self._one_at_a_time:
            if self._connection is not None:
                try:
                    self._connection.execute(_NAME, {"name": self._session_name()})
                except DBAPIError:  # `check` takes the lock again under this name
                    self._forget()

    def check(self) -> None:
        """Check that the lock is still held, and beat; take it again after an outage of the server.

        Raises:
            StoreUnavailableError: If the server does not answer now.
            DatabaseTakenError: If another service took it meanwhile.
        """
        with self._one_at_a_time:
            try:
                if self._connection is not None:
                    self._beat(self._connection)
                    return
            except DBAPIError as error:
                if (
                    not error.connection_invalidated
                ):  # it refuses, such as a server that is read only
                    raise self._unavailable(error) from error
                self._forget()
                log.warning("lock on the database lost, taking it again", problem=first_line(error))
            try:
                self._take()
            except StateInUseError as error:
                raise DatabaseTakenError(f"{error}; this one ends") from None
            log.info("lock on the database taken again")
            if self._connection is not None:
                try:
                    self._beat(self._connection)
                except DBAPIError as error:
                    self._forget()
                    raise self._unavailable(error) from error

    def _beat(self, connection: Connection) -> None:
        began_s = time.monotonic()
        if self._term is None:
            connection.execute(text("SELECT 1"))
        elif not beat(connection, term=self._term, lease_s=self._lease_s):
            raise DatabaseTakenError(
                f"another service serves the database now ({self._name}); this one ends"
            )
        self._beaten_s = began_s
        if self._term is not None:
            self._standbys = standbys(connection)

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
            connection.execute(_NAME, {"name": self._session_name()})
            for wait_s in _PATIENCE_S:
                if connection.execute(TAKE, {"lock": LOCK}).scalar_one():
                    return
                time.sleep(wait_s)
            name, where = named_holder(connection)
        except OperationalError as error:
            self._forget()
            raise self._unavailable(error) from error
        self._forget()
        endpoint = name.partition(" ")[2]
        at = f" at {endpoint}" if endpoint else ""
        raise StateInUseError(
            f"a service already holds this database: one{at} connected from {where} ({self._name})"
            + (f"; --connect {endpoint}" if endpoint else "")
        )

    def _unavailable(self, error: DBAPIError) -> StoreUnavailableError:
        return StoreUnavailableError(
            f"cannot use the database: {first_line(error)} ({self._name}); "
            "nothing acknowledged is lost, try again when that is fixed"
        )

    def _session_name(self) -> str:
        return f"{self.ident} {self._endpoint}".strip()[:63]  # PostgreSQL keeps no more

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


def lock_engine(url: str, *, session_name: str = "") -> Engine:
    """Make an engine for single connections, whose loss the server notices within 30 s."""
    named = {"application_name": session_name} if session_name else {}
    return postgres_engine(
        url,
        poolclass=NullPool,
        isolation_level="AUTOCOMMIT",
        connect_args={**PATIENCE, **named, "options": _KEEPALIVE},
    )


def first_line(error: DBAPIError) -> str:
    """Keep the first line of the driver's message, since the rest repeats the query."""
    return str(error.orig).splitlines()[0] if str(error.orig) else type(error.orig).__name__
