"""Warnings about requests, of which a flood fills no disk: one a second for each kind."""

import time
from collections.abc import Callable
from threading import Lock
from typing import Any, Final

import structlog

log = structlog.get_logger(__name__)

INTERVAL_S: Final = 1.0
"""Least time between two warnings of one kind, seconds."""


class SparseLog:
    """Logs the first warning of a kind in an interval, and counts the others; for any thread.

    Kinds are names of verbs, so that their number is bounded.
    """

    def __init__(self, *, clock: Callable[[], float] = time.monotonic) -> None:
        """Take the clock, seconds."""
        self._clock, self._lock = clock, Lock()
        self._said_s: dict[tuple[str, str], float] = {}
        self._unsaid: dict[tuple[str, str], int] = {}

    def warn(self, event: str, *, asked: str, **fields: Any) -> None:
        """Log a warning about a request, unless one of its kind was logged a moment ago.

        Args:
            event: What happened.
            asked: The verb.
            fields: More of the entry; `unsaid` is added: the number of those that were not logged.
        """
        kind, now_s = (event, asked), self._clock()
        with self._lock:
            if now_s < self._said_s.get(kind, -INTERVAL_S) + INTERVAL_S:
                self._unsaid[kind] = self._unsaid.get(kind, 0) + 1
                return
            self._said_s[kind] = now_s
            unsaid = self._unsaid.pop(kind, 0)
        log.warning(event, asked=asked, **fields, **({"unsaid": unsaid} if unsaid else {}))
