"""Questions from the bus, queued by callbacks and answered by threads of our own.

Zenoh calls one callback at a time, and a callback that waits blocks every other one of its session.
So a callback only enqueues, and whoever asks too fast is told to ask again.
"""

import queue
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from threading import Event
from typing import Final

import structlog
import zenoh
from pydantic import ValidationError

from schemas.ask import reply_problem
from schemas.errors import CounterpointError, PermanentError, TransientError

log = structlog.get_logger(__name__)

Answer = Callable[[zenoh.Query], None]
"""Replies to one query; what it raises on purpose becomes the reply."""

MOST_WAITING: Final = 4096
"""Questions in the queue before new ones are sent back to ask again."""

_IDLE_S: Final = 0.2
"""How often an idle thread looks whether it should end."""


class Questions:
    """One queue for all queryables of the service, and as many threads as care to serve it."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._waiting: queue.Queue[tuple[Answer, zenoh.Query]] = queue.Queue(MOST_WAITING)
        self._queryables = ExitStack()

    def declare(self, key: str, answer: Answer) -> None:
        """Answer the questions for a key, completely: nobody else holds more."""
        self._queryables.enter_context(
            self._session.declare_queryable(key, partial(self._enqueue, answer), complete=True)
        )

    def serve(self, stop: Event) -> None:
        """Answer questions until told to stop; run it in as many threads as should answer."""
        while not stop.is_set():
            try:
                answer, query = self._waiting.get(timeout=_IDLE_S)
            except queue.Empty:
                continue
            with query:
                _answer(answer, query)

    def close(self) -> None:
        """Take no more questions; those unanswered end empty, which means: ask again."""
        self._queryables.close()
        while True:
            try:
                _, query = self._waiting.get_nowait()
            except queue.Empty:
                return
            with query:  # dropped without a reply
                pass

    def _enqueue(self, answer: Answer, query: zenoh.Query) -> None:
        try:
            self._waiting.put_nowait((answer, query))
        except queue.Full:
            with query:
                reply_problem(query, TransientError("the service is busy; ask again"))


def _answer(answer: Answer, query: zenoh.Query) -> None:
    key = str(query.key_expr)
    try:
        answer(query)
    except ValidationError as error:
        reply_problem(query, PermanentError(f"not a question for {key}: {_first_problem(error)}"))
    except CounterpointError as error:
        log.warning("question refused", key=key, problem=str(error))
        reply_problem(query, error)
    except zenoh.ZError as error:  # the asker is gone, or the session is closing
        log.warning("reply not sent", key=key, problem=str(error))


def _first_problem(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    return f"{'.'.join(map(str, first['loc'])) or 'payload'}: {first['msg']}"
