"""Watch of the connection between a session and its routers, which Zenoh does not report."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from threading import Event, Thread
from types import TracebackType
from typing import Final, Self

import structlog
import zenoh

from schemas.transport.bus import is_connected

log = structlog.get_logger(__name__)

LOOK_S: Final = 0.5


class RouterWatch(AbstractContextManager["RouterWatch"]):
    """Polls the connection twice a second from a thread of its own, while the session is open."""

    def __init__(
        self,
        session: zenoh.Session,
        on_change: Callable[[bool], None],
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Watch a session.

        Args:
            session: The session; it reconnects to its routers by itself.
            on_change: Called with true if a router is connected, first at the start and then at
                every change.
            clock: Monotonic seconds.
        """
        self._session, self._on_change, self._clock = session, on_change, clock
        self._done = Event()
        self._thread = Thread(target=self._watch, name="router", daemon=True)

    def __enter__(self) -> Self:
        """Start polling."""
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop polling."""
        self._done.set()
        self._thread.join()

    def _watch(self) -> None:
        connected, lost_at_s = is_connected(self._session), self._clock()
        self._on_change(connected)
        while not self._done.wait(LOOK_S):
            now = is_connected(self._session)
            if now == connected:
                continue
            connected = now
            self._on_change(now)
            if now:
                log.info("router is back", away_s=round(self._clock() - lost_at_s, 1))
            else:
                lost_at_s = self._clock()
                log.warning("router lost: waiting for it")
