"""Standby of a service: waits until a PostgreSQL database has no service that lives, then takes it.

A holder that died has freed its lock, and is followed at once. One that is frozen or cut off keeps
the lock: when its beats stay away for the time of its lease, its sessions are ended first.
"""

import time
from collections.abc import Callable
from contextlib import suppress
from threading import Event
from typing import Final

import structlog
from sqlalchemy import Connection
from sqlalchemy.exc import DBAPIError

from schemas.errors import TransientError
from schemas.runtime.retry import StoppedError
from service.errors import StateInUseError
from service.store.service_lease import STANDBY, LeaseSeen, end_holder, look
from service.store.single_writer_lock import SoleService, first_line, lock_engine

log = structlog.get_logger(__name__)

LOOK_S: Final = 0.5
"""Interval of looks at the lease, seconds; part of the time of a takeover."""

_FROZEN_S: Final = 2.0
"""Time between two looks after which this process was frozen itself, and measures from there."""


class Silence:
    """Measures the silence of a holder by the looks at its beats."""

    def __init__(self, *, default_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin with a silence of 0.

        Args:
            default_s: Longest silence of a holder that has not stated its own, seconds.
            clock: Monotonic seconds.
        """
        self._default_s, self._clock = default_s, clock
        self._beats: int | None = None
        self._since_s = self._looked_s = clock()

    def is_over(self, seen: LeaseSeen) -> bool:
        """Return true if the holder has been silent for longer than its lease."""
        now_s = self._clock()
        slept = now_s - self._looked_s > _FROZEN_S
        self._looked_s = now_s
        if seen.beats is None or seen.beats != self._beats or slept:
            self._beats, self._since_s = seen.beats, now_s
            return False
        return now_s - self._since_s > (seen.lease_s or self._default_s)


class Standby:
    """Waits for the exclusive right to serve a database.

    Attributes:
        problem: Cause for which it could not take over now; empty: it could.
        is_waiting: True while another service holds the database.
    """

    def __init__(self, url: str, *, lease_s: float) -> None:
        """Prepare; `wait` waits.

        Args:
            url: URL of the database, as SQLAlchemy takes it.
            lease_s: Longest silence of a holder that has not stated its own, seconds.
        """
        self._url, self._lease_s = url, lease_s
        self.problem = "the database has not been reached yet"
        self.is_waiting = True

    def wait(self, stop: Event, *, on_held: Callable[[], None] = lambda: None) -> SoleService:
        """Wait until no service holds the database, and take it.

        Args:
            stop: Ends the wait.
            on_held: Called once if another service holds it.

        Raises:
            StoppedError: If `stop` was set before.
        """
        engine = lock_engine(self._url, session_name=STANDBY)
        silence = Silence(default_s=self._lease_s)
        connection: Connection | None = None
        told = False
        try:
            while not stop.is_set():
                try:
                    connection = connection or engine.connect()
                    taken = self._try(connection, silence)
                except DBAPIError as error:
                    self._say(first_line(error))
                    if connection is not None:
                        with suppress(DBAPIError):
                            connection.close()
                    connection = None
                except TransientError as error:
                    self._say(str(error))
                else:
                    self.problem = ""
                    if taken is not None:
                        self.is_waiting = False
                        return taken
                    if not told:
                        on_held()
                        told = True
                stop.wait(LOOK_S)
            raise StoppedError("stopped while standing by")
        finally:
            if connection is not None:
                with suppress(DBAPIError):
                    connection.close()
            engine.dispose()

    def _try(self, connection: Connection, silence: Silence) -> SoleService | None:
        seen = look(connection)
        is_silent = silence.is_over(seen)
        if seen.holder is not None and not is_silent:
            return None
        if seen.holder is not None:
            ended = end_holder(connection, seen)
            log.warning("the active service is silent, its sessions are ended", sessions=ended)
        try:
            return SoleService(self._url)
        except StateInUseError:  # another standby was faster
            return None

    def _say(self, problem: str) -> None:
        if self.problem != problem:
            log.warning("standby cannot see the active service", problem=problem)
        self.problem = problem
