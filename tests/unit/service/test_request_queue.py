"""What an answer raises goes to the asker, and never ends a thread."""

from threading import Event, Thread
from typing import Any

import pytest
import structlog.testing
import zenoh

from schemas.bounds import MAX_QUESTION_BYTES
from schemas.errors import PermanentError, TransientError
from schemas.problem import Problem
from schemas.transport.wire import decode
from service.api.request_queue import Answer, Outcome, RequestQueue
from service.errors import StateUnusableError

KEY = "test/v1/ctl/top"


class Panic(BaseException):
    """What the binding of Zenoh raises is no `Exception` either."""


class Asking:
    """A session by itself, which answers its own questions."""

    def __init__(self, answer: Answer) -> None:
        config = zenoh.Config()
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("listen/endpoints", "[]")
        self._session = zenoh.open(config)
        self.outcomes: list[Outcome] = []
        self.faults = 0
        self.ended: BaseException | None = None
        self._questions = RequestQueue(
            self._session,
            on_outcome=lambda _, outcome: self.outcomes.append(outcome),
            on_fault=self._count,
        )
        self._questions.declare(KEY, answer, asked="top")
        self._stop = Event()
        self._thread = Thread(target=self._serve)

    def _count(self) -> None:
        self.faults += 1

    def _serve(self) -> None:
        try:
            self._questions.serve(self._stop, writes=False)
        except BaseException as error:  # noqa: BLE001
            self.ended = error

    def __enter__(self) -> "Asking":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._questions.close()
        self._session.close()  # type: ignore[no-untyped-call]

    def ask(self, payload: bytes = b"{}") -> bytes | Problem | None:
        for reply in self._session.get(KEY, payload=payload, timeout=10):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
            assert reply.err is not None
            return decode(Problem, reply.err.payload.to_bytes())
        return None


@pytest.mark.parametrize(
    ("error", "outcome", "transient"),
    [
        (OverflowError("Python int too large to convert to SQLite INTEGER"), "fault", False),
        (Panic("called `Result::unwrap()` on an `Err` value"), "fault", False),
        (PermanentError("no such scene"), "refused", False),
        (TransientError("the disk is full"), "try_again", True),
    ],
)
def test_what_an_answer_raises_is_told_and_the_next_question_is_answered(
    error: BaseException, outcome: Outcome, transient: bool
) -> None:
    raising: list[BaseException] = [error]

    def answer(payload: bytes) -> bytes:
        if raising:
            raise raising.pop()
        return b"well"

    with structlog.testing.capture_logs() as said, Asking(answer) as asking:
        problem = asking.ask()
        assert isinstance(problem, Problem)
        assert str(error) in problem.problem
        assert problem.transient is transient
        assert asking.ask() == b"well"
    assert asking.outcomes == [outcome, "answered"]
    assert asking.faults == (outcome == "fault")
    traces = [entry["exc_info"] for entry in said if "exc_info" in entry]
    assert traces == ([error] if outcome == "fault" else [])


def test_a_state_that_cannot_be_used_ends_the_service() -> None:
    error = StateUnusableError("not a database")

    def answer(payload: bytes) -> bytes:
        raise error

    with Asking(answer) as asking:
        assert asking.ask() is None
    assert asking.ended is error


def test_a_payload_beyond_its_bound_is_refused_unread() -> None:
    read: list[Any] = []

    def answer(payload: bytes) -> bytes:
        read.append(payload)
        return b""

    with Asking(answer) as asking:
        problem = asking.ask(b" " * (MAX_QUESTION_BYTES + 1))
    assert isinstance(problem, Problem)
    assert "request too large" in problem.problem
    assert (read, asking.outcomes) == ([], ["refused"])
