"""Request queue: bus callbacks enqueue requests, and threads of the service answer them.

Zenoh calls one callback at a time, and a callback that waits blocks every other one of its session.
So a callback only enqueues, and excess requests are refused with a request to try again. Requests
that write wait for the disk, or for a locked database. They have threads of their own, so that
`status` and `top` are answered meanwhile. Equal reading requests are answered together.

Requests wait in lanes that are served in turn: one for each held lease, one for each verb and name
of a certificate, one for each verb of all others. A flood delays its own lane.

Any error of a handler goes to the client and to the log, and the thread goes on: a request must
never end the service.
"""

import threading
import time
from collections.abc import Callable, Hashable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from threading import Event
from typing import Final, Literal

import structlog
import zenoh
from pydantic import ValidationError

from schemas.bounds import MAX_COMMIT_BYTES, MAX_NAME, MAX_QUESTION_BYTES
from schemas.errors import CounterpointError, PermanentError, TransientError
from schemas.transport import keys
from schemas.transport.ask import reply_problem
from schemas.transport.wire import first_problem
from service.api.bounded_queue import Waiting
from service.api.held_leases import HeldLeases
from service.api.sparse_log import SparseLog
from service.api.verbs import HISTORY, OF_WORKERS, VERBS
from service.errors import StateUnusableError
from service.store.audit import Actor, acting

log = structlog.get_logger(__name__)

Answer = Callable[[bytes], bytes]
"""Handler that maps a payload to a reply; an error raised on purpose becomes the reply."""

Replier = Callable[[zenoh.Query], None]
"""Handler that sends any number of replies; an error raised on purpose becomes the last one."""

Outcome = Literal["answered", "refused", "try_again", "malformed", "unsent", "fault"]
"""Outcome of a request.

`answered`: replied. `refused`: impossible. `try_again`: impossible now. `malformed`: not
understood. `unsent`: the client had gone. `fault`: an unexpected error, with its trace in the log.
"""

MOST_WAITING: Final = 4096
"""Requests in a queue before new ones are refused with a request to try again."""

MOST_WAITING_BYTES: Final = 2 * MAX_COMMIT_BYTES
"""Total bytes of the requests in a queue, with the same effect."""

LARGE_BYTES: Final = 4 * 2**20
"""Payload size above which requests are decoded one at a time, bytes; memory is ten times that."""

MOST_REST_S: Final = 0.25

_IDLE_S: Final = 0.2
"""Interval at which an idle thread checks for the end, seconds."""


@dataclass(frozen=True, slots=True)
class _Request:
    """One request and its handler: `answer` takes the payload, `replier` the query itself."""

    asked: str
    query: zenoh.Query
    payload: bytes
    actor: Actor
    answer: Answer | None = None
    replier: Replier | None = None


class RequestQueue:
    """Two request queues, for reading and writing, that any number of threads serve."""

    def __init__(
        self,
        session: zenoh.Session,
        *,
        leases: HeldLeases | None = None,
        names_proved: bool = False,
        on_outcome: Callable[[str, Outcome], None] = lambda _asked, _outcome: None,
        on_fault: Callable[[], None] = lambda: None,
    ) -> None:
        """Keep the session and the callbacks.

        Args:
            session: On the bus.
            leases: Leases that the handlers know to be held; None: they know of none.
            names_proved: Rules of the router let a client ask under its certificate's name alone.
            on_outcome: Called with the outcome of each request.
            on_fault: Called for each answer that failed with an unexpected error.
        """
        self._session, self._on_outcome, self._on_fault = session, on_outcome, on_fault
        self._leases, self._names_proved = leases or HeldLeases(), names_proved
        self._writes: Waiting[_Request] = Waiting(most=MOST_WAITING, most_bytes=MOST_WAITING_BYTES)
        self._reads: Waiting[_Request] = Waiting(most=MOST_WAITING, most_bytes=MOST_WAITING_BYTES)
        self._large = threading.Lock()
        self._refusals = SparseLog()
        self._unable: dict[str, str] = {}
        """Current problem, by kind of request; each is logged once until it passes."""
        self._queryables = ExitStack()

    @property
    def waiting(self) -> int:
        """Count the requests that no thread has taken yet."""
        return len(self._writes) + len(self._reads)

    def declare(self, key: str, answer: Answer, *, asked: str) -> None:
        """Answer the requests of a verb as the only queryable of its key.

        Args:
            key: Key of the requests.
            answer: Handler of one payload.
            asked: The verb.
        """
        self._declare(key, lambda query: self._enqueue(asked, query, answer=answer))

    def declare_named(self, key: str, answer: Answer, *, asked: str) -> None:
        """Answer the requests of a verb that name who asks, in the last part of their key.

        Args:
            key: Key expression of the requests, which ends in `/*`.
            answer: Handler of one payload; `service.store.audit.actor` is who asks.
            asked: The verb.
        """

        def named(query: zenoh.Query) -> None:
            name = keys.name_of_asker(str(query.key_expr))
            if name:
                self._enqueue(asked, query, answer=answer, name=name)
            else:
                problem = PermanentError("a request names one asker, not several")
                self._send_back(asked, query, problem, "refused")

        self._declare(key, named)

    def declare_history(self, key: str, replier: Replier) -> None:
        """Answer the history requests of a key as its only, complete queryable.

        Args:
            key: Key of the requests.
            replier: Handler of one query.
        """
        self._declare(key, lambda query: self._enqueue(HISTORY, query, replier=replier))

    def serve(self, stop: Event, *, writes: bool) -> None:
        """Answer requests until `stop` is set; call it in each answering thread.

        Args:
            stop: Ends the loop.
            writes: True to answer requests that write, false for the others.

        Raises:
            StateUnusableError: If the database is damaged, and no request can be answered any more.
        """
        waiting = self._writes if writes else self._reads
        while not stop.is_set():
            taken = waiting.take(timeout_s=_IDLE_S)
            if taken is None:
                continue
            requests, began_s = list(taken.items), time.monotonic()
            try:
                self._serve(requests)
            finally:
                took_s = time.monotonic() - began_s
                rests = _reads_all(requests[0].asked)
                waiting.done(taken, rest_s=min(took_s, MOST_REST_S) if rests else 0.0)

    def close(self) -> None:
        """Refuse new requests; unanswered ones end empty, which means: try again."""
        self._queryables.close()
        for waiting in (self._writes, self._reads):
            while (taken := waiting.take(timeout_s=0)) is not None:
                waiting.done(taken)  # the thread that took others answers them
                for request in taken.items:
                    with request.query:  # dropped without a reply
                        pass

    def _declare(self, key: str, callback: Callable[[zenoh.Query], None]) -> None:
        self._queryables.enter_context(
            self._session.declare_queryable(key, callback, complete=True)
        )

    def _enqueue(
        self,
        asked: str,
        query: zenoh.Query,
        *,
        answer: Answer | None = None,
        replier: Replier | None = None,
        name: str = "",
    ) -> None:
        verb = VERBS.get(asked)
        most_bytes = MAX_QUESTION_BYTES if verb is None else verb.most_bytes
        size = 0 if query.payload is None else len(query.payload)
        if size > most_bytes:
            problem = f"request too large: {size} bytes, {asked} accepts {most_bytes}"
            self._send_back(asked, query, PermanentError(problem), "refused")
            return
        takes_payload = verb is not None and verb.request is not None and query.payload is not None
        payload = query.payload.to_bytes() if takes_payload and query.payload is not None else b""
        actor = Actor(name, _stated(query), "bus")
        request = _Request(asked, query, payload, actor, answer, replier)
        waiting = self._writes if verb is not None and verb.writes else self._reads
        alike = verb is not None and not verb.writes
        kind = (asked, payload) if alike else object()
        turn = asked if _reads_all(asked) else None
        lane = self._lane(asked, payload, name=name)
        for other in waiting.offer(kind, request, size=size, lane=lane, turn=turn):
            busy = TransientError("the service is busy; ask again")
            self._send_back(other.asked, other.query, busy, "try_again")

    def _lane(self, asked: str, payload: bytes, *, name: str) -> Hashable:
        lease_id = self._leases.held_in(payload) if asked in OF_WORKERS else None
        return ("lease", lease_id) if lease_id else (asked, name if self._names_proved else "")

    def _send_back(
        self, asked: str, query: zenoh.Query, error: CounterpointError, outcome: Outcome
    ) -> None:
        with query:
            self._refuse(query, error)
        self._on_outcome(asked, outcome)

    def _serve(self, requests: list[_Request]) -> None:
        """Answer equal requests with one reply."""
        first = requests[0]
        with ExitStack() as opened:
            for request in requests:
                opened.enter_context(request.query)
            try:
                outcome = self._answer(first, requests)
            except StateUnusableError:
                raise  # ends the service; the asker gets no answer, and asks the next one
            except (KeyboardInterrupt, SystemExit):
                raise
            except BaseException as error:  # noqa: BLE001  (also a panic of Zenoh's)
                outcome = self._fault(error, requests)
        for request in requests:
            self._on_outcome(request.asked, outcome)

    def _answer(self, first: _Request, requests: list[_Request]) -> Outcome:
        asked = first.asked
        try:
            if first.replier is not None:
                first.replier(first.query)
            elif first.answer is not None:
                with acting(first.actor):
                    answer = self._made(first.answer, first.payload)
                sent = [self._reply(asked, request.query, answer) for request in requests]
                if not any(sent):
                    return "unsent"
        except MalformedError as error:
            self._refuse_all(requests, error)
            return "malformed"
        except TransientError as error:
            if self._unable.get(asked) != str(error):
                self._unable[asked] = str(error)
                log.warning("request not answered now", asked=asked, problem=str(error))
            self._refuse_all(requests, error)
            return "try_again"
        except StateUnusableError:
            raise
        except CounterpointError as error:
            self._refusals.warn("request refused", asked=asked, problem=str(error))
            self._refuse_all(requests, error)
            return "refused"
        except zenoh.ZError as error:  # the asker is gone, or the session is closing
            self._refusals.warn("reply not sent", asked=asked, problem=str(error))
            return "unsent"
        if self._unable.pop(asked, None) is not None:
            log.info("requests answered again", asked=asked)
        return "answered"

    def _reply(self, asked: str, query: zenoh.Query, answer: bytes) -> bool:
        try:
            query.reply(query.key_expr, answer)
        except zenoh.ZError as error:  # the asker is gone, or the session is closing
            self._refusals.warn("reply not sent", asked=asked, problem=str(error))
            return False
        return True

    def _made(self, answer: Answer, payload: bytes) -> bytes:
        if len(payload) <= LARGE_BYTES:
            return answer(payload)
        if not self._large.acquire(blocking=False):
            raise TransientError("the service is busy with another large message; ask again")
        try:
            return answer(payload)
        finally:
            self._large.release()

    def _fault(self, error: BaseException, requests: list[_Request]) -> Outcome:
        asked = requests[0].asked
        log.error("request failed: a fault of the program", asked=asked, exc_info=error)
        self._on_fault()
        said = (str(error).splitlines() or [""])[0][:300]
        problem = PermanentError(
            f"the service failed to answer {asked}: {type(error).__name__}: {said}; "
            "this is a fault of the program, and its log has the trace"
        )
        self._refuse_all(requests, problem)
        return "fault"

    def _refuse_all(self, requests: list[_Request], error: CounterpointError) -> None:
        for request in requests:
            self._refuse(request.query, error)

    def _refuse(self, query: zenoh.Query, error: CounterpointError) -> None:
        with suppress(zenoh.ZError):  # the asker is gone, or the session is closing
            reply_problem(query, error)


def _stated(query: zenoh.Query) -> str:
    """Return the name that an asker gives itself, cut; empty without one."""
    if query.attachment is None:
        return ""
    return query.attachment.to_bytes()[: 4 * MAX_NAME].decode("utf-8", "replace")[:MAX_NAME]


def _reads_all(asked: str) -> bool:
    return asked in VERBS and VERBS[asked].reads_all


class MalformedError(PermanentError):
    """A payload is no valid request of its verb."""


def malformed(asked: str, error: ValidationError) -> MalformedError:
    """Make the error that names the first invalid field of a request."""
    return MalformedError(f"not a request for {asked}: {first_problem(error)}")
