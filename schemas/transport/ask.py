"""Requests over the bus, sent once or until answered; each gets a reply or a problem.

Silence and refusal are different. A service that died, has not started or lost its router gives an
empty reply or a timeout, and a retry is right; a problem that it names itself is final.
"""

import time
from threading import Event
from typing import Final

import structlog
import zenoh

from schemas.errors import CounterpointError, PermanentError, TransientError
from schemas.problem import Problem
from schemas.runtime.retry import backoff_s, pause
from schemas.transport.wire import decode, encode

log = structlog.get_logger(__name__)

PROBLEM: Final = zenoh.Encoding("application/json").with_schema("counterpoint.problem.v1")
"""Encoding of an error reply of ours; Zenoh's own, such as a timeout, has another."""

SILENT_S: Final = 20.0
"""Time without any answer after which that is logged, seconds; a restart takes less."""

SILENT: Final = (
    f"no answer for {SILENT_S:g} s, and asked on: is the service up? If it is, do the rules of the "
    "routers name this certificate (counterpoint acl)?"
)


class UnansweredError(TransientError):
    """No reply came: no service runs yet, it died while answering, or the time was up."""


def ask(
    session: zenoh.Session,
    key: str,
    payload: bytes = b"",
    *,
    timeout_s: float = 10,
    says: str = "",
) -> bytes:
    """Send a request to a queryable once.

    Args:
        session: Session to send it on.
        key: Key of the queryable.
        payload: Encoded request.
        timeout_s: Timeout, seconds.
        says: Name of the asker, sent along for the audit log; empty: none.

    Raises:
        UnansweredError: If there was no reply, or none in time; a retry may help.
        TransientError: If the reply is a problem that may pass.
        PermanentError: If the reply is a problem that a retry cannot cure.
    """
    for reply in session.get(
        key,
        payload=payload,
        timeout=timeout_s,
        target=zenoh.QueryTarget.BEST_MATCHING,
        consolidation=zenoh.ConsolidationMode.NONE,
        attachment=says or None,
    ):
        if reply.ok is not None:
            return reply.ok.payload.to_bytes()
        if reply.err is not None and reply.err.encoding == PROBLEM:
            raise _as_error(decode(Problem, reply.err.payload.to_bytes()))
        raise UnansweredError(f"no answer within {timeout_s:g} s from the service ({key})")
    raise UnansweredError(f"no service answers ({key}); is `counterpoint run` up?")


def ask_until(
    session: zenoh.Session,
    key: str,
    payload: bytes = b"",
    *,
    stop: Event,
    patience_s: float = float("inf"),
    timeout_s: float = 10,
    says: str = "",
) -> bytes:
    """Send a request until it is answered, as a worker does for every acknowledged step.

    A problem that may pass, such as a full disk on the other side, is retried like silence.

    Args:
        session: Session to send it on.
        key: Key of the queryable.
        payload: Encoded request.
        stop: Give up when this is set.
        patience_s: Give up after this time, seconds.
        timeout_s: Timeout of one attempt, seconds.
        says: Name of the asker, sent along for the audit log; empty: none.

    Raises:
        UnansweredError: If patience ran out without a reply.
        TransientError: If patience ran out, and the last reply was a problem that may pass.
        StoppedError: If `stop` was set.
        PermanentError: If the reply is a problem that a retry cannot cure.
    """
    began_s = time.monotonic()
    give_up_s, silent = began_s + patience_s, False
    waits = backoff_s(first_s=0.02, most_s=0.5)
    said = False
    while True:
        try:
            answer = ask(session, key, payload, timeout_s=timeout_s, says=says)
            if silent:
                log.info("the service answers again", key=key)
            return answer
        except TransientError as error:
            now_s = time.monotonic()
            if now_s >= give_up_s:
                raise
            if isinstance(error, UnansweredError) and not silent and now_s >= began_s + SILENT_S:
                log.warning("no service answers", key=key, problem=SILENT)
                silent = True
            if not said:
                say = log.debug if isinstance(error, UnansweredError) else log.warning
                say("asking again", key=key, problem=str(error))
                said = True
        pause(stop, next(waits))


def reply_problem(query: zenoh.Query, error: CounterpointError) -> None:
    """Reply to a query with the problem that prevents an answer."""
    transient = isinstance(error, TransientError)
    query.reply_err(encode(Problem(problem=str(error), transient=transient)), encoding=PROBLEM)


def _as_error(problem: Problem) -> CounterpointError:
    kind = TransientError if problem.transient else PermanentError
    return kind(problem.problem)
