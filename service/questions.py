"""Questions from the bus, queued by callbacks and answered by threads of our own.

Zenoh calls one callback at a time, and a callback that waits blocks every other one of its session.
So a callback only enqueues, and whoever asks too fast is told to ask again. What writes waits for
the disk, or for a database that is locked; it has threads of its own, so that `status` and `top`
are answered meanwhile.
"""

import queue
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from threading import Event
from typing import Final, Literal

import structlog
import zenoh
from pydantic import ValidationError

from schemas.ask import reply_problem
from schemas.errors import CounterpointError, PermanentError, TransientError
from schemas.keys import Verb
from service.errors import StateUnusableError

log = structlog.get_logger(__name__)

Asked = Literal[Verb, "history"]
"""What was asked: a verb, or the scenes and selections that there are."""

Answer = Callable[[zenoh.Query], None]
"""Replies to one query; what it raises on purpose becomes the reply."""

Outcome = Literal["answered", "refused", "try_again", "malformed", "unsent"]
"""How a question ended: answered; never possible; not now; not understood; the asker had gone."""

WRITES: Final[frozenset[Asked]] = frozenset({"claim", "renew", "commit", "fail", "select", "retry"})
"""Questions that are answered only after a transaction."""

MOST_WAITING: Final = 4096
"""Questions in a queue before new ones are sent back to ask again."""

_IDLE_S: Final = 0.2
"""How often an idle thread looks whether it should end."""


class Questions:
    """Two queues for all queryables of the service, and as many threads as care to serve them."""

    def __init__(
        self,
        session: zenoh.Session,
        *,
        on_outcome: Callable[[Asked, Outcome], None] = lambda _asked, _outcome: None,
    ) -> None:
        """Take the session, and whom to tell how each question ended."""
        self._session, self._on_outcome = session, on_outcome
        self._writes: queue.Queue[tuple[Asked, Answer, zenoh.Query]] = queue.Queue(MOST_WAITING)
        self._reads: queue.Queue[tuple[Asked, Answer, zenoh.Query]] = queue.Queue(MOST_WAITING)
        self._unable: dict[Asked, str] = {}
        """What cannot be answered now, and why: said once, until it can be again."""
        self._queryables = ExitStack()

    @property
    def waiting(self) -> int:
        """How many questions nobody has taken up yet."""
        return self._writes.qsize() + self._reads.qsize()

    def declare(self, key: str, answer: Answer, *, asked: Asked = "history") -> None:
        """Answer the questions for a key, completely: nobody else holds more.

        Args:
            key: What they are put to.
            answer: Replies to one.
            asked: What they are counted as.
        """
        self._queryables.enter_context(
            self._session.declare_queryable(
                key, partial(self._enqueue, asked, answer), complete=True
            )
        )

    def serve(self, stop: Event, *, writes: bool) -> None:
        """Answer questions until told to stop; run it in as many threads as should answer.

        Args:
            stop: When to end.
            writes: Whether to answer those that write, or the others.

        Raises:
            StateUnusableError: If the database is damaged: no answer will ever come from it.
        """
        waiting = self._writes if writes else self._reads
        while not stop.is_set():
            try:
                asked, answer, query = waiting.get(timeout=_IDLE_S)
            except queue.Empty:
                continue
            with query:
                outcome = self._answer(asked, answer, query)
            self._on_outcome(asked, outcome)

    def close(self) -> None:
        """Take no more questions; those unanswered end empty, which means: ask again."""
        self._queryables.close()
        for waiting in (self._writes, self._reads):
            while not waiting.empty():  # whoever still takes one out answers it
                with suppress(queue.Empty):
                    _, _, query = waiting.get_nowait()
                    with query:  # dropped without a reply
                        pass

    def _enqueue(self, asked: Asked, answer: Answer, query: zenoh.Query) -> None:
        try:
            (self._writes if asked in WRITES else self._reads).put_nowait((asked, answer, query))
        except queue.Full:
            with query:
                reply_problem(query, TransientError("the service is busy; ask again"))
            self._on_outcome(asked, "try_again")

    def _answer(self, asked: Asked, answer: Answer, query: zenoh.Query) -> Outcome:
        key = str(query.key_expr)
        try:
            answer(query)
        except ValidationError as error:
            problem = f"not a question for {key}: {_first_problem(error)}"
            reply_problem(query, PermanentError(problem))
            return "malformed"
        except TransientError as error:
            if self._unable.get(asked) != str(error):
                self._unable[asked] = str(error)
                log.warning("question not answered now", asked=asked, problem=str(error))
            reply_problem(query, error)
            return "try_again"
        except StateUnusableError:
            raise  # ends the service; the asker gets no answer, and asks the next one
        except CounterpointError as error:
            log.warning("question refused", key=key, problem=str(error))
            reply_problem(query, error)
            return "refused"
        except zenoh.ZError as error:  # the asker is gone, or the session is closing
            log.warning("reply not sent", key=key, problem=str(error))
            return "unsent"
        if self._unable.pop(asked, None) is not None:
            log.info("questions answered again", asked=asked)
        return "answered"


def _first_problem(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    return f"{'.'.join(map(str, first['loc'])) or 'payload'}: {first['msg']}"
