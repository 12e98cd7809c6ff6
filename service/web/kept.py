"""Answers that several pages need within seconds, asked once at a time and kept for a while."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from typing import Final, Generic, TypeVar

Answer = TypeVar("Answer")

MOST_KEPT: Final = 50
"""Answers of one kind that are kept; the oldest is dropped."""


class Kept(Generic[Answer]):
    """Answers by question; equal questions that come at once are asked once."""

    def __init__(self, *, age_s: float) -> None:
        """Keep answers up to an age, seconds."""
        self._age_s = age_s
        self._lock = threading.Lock()
        self._answers: OrderedDict[Hashable, tuple[float, Answer]] = OrderedDict()
        self._asked: dict[Hashable, Future[Answer]] = {}
        self._era = 0

    def of(self, question: Hashable, ask: Callable[[], Answer]) -> Answer:
        """Return the kept answer, else that of `ask`; what it raises is not kept."""
        fresh, asked, is_mine = self._begin(question)
        if fresh is not None:
            return fresh[0]
        if is_mine:
            self._answer(question, ask, asked)
        return asked.result()

    def within(
        self, question: Hashable, ask: Callable[[], Answer], *, patience_s: float
    ) -> Answer | None:
        """Return the answer as `of` does, but ask in the background and wait for some time only.

        Returns:
            After that time an older answer; None without one, and `ask` goes on for the next call.
        """
        fresh, asked, is_mine = self._begin(question)
        if fresh is not None:
            return fresh[0]
        if is_mine:
            threading.Thread(
                target=self._answer, args=(question, ask, asked), name="asking", daemon=True
            ).start()
        try:
            return asked.result(patience_s)
        except TimeoutError:
            if asked.done():  # just now, or by a TimeoutError of its own
                return asked.result()
        with self._lock:
            older = self._answers.get(question)
        return older[1] if older else None

    def forget(self) -> None:
        """Ask again next time, also where an answer is under way."""
        with self._lock:
            self._answers.clear()
            self._asked.clear()
            self._era += 1

    def _begin(self, question: Hashable) -> tuple[tuple[Answer] | None, Future[Answer], bool]:
        """Return the fresh answer if there is one, the pending one, and if it is to be asked."""
        with self._lock:
            kept = self._answers.get(question)
            if kept is not None and time.monotonic() - kept[0] < self._age_s:
                return (kept[1],), Future(), False
            if (pending := self._asked.get(question)) is not None:
                return None, pending, False
            made: Future[Answer] = Future()
            self._asked[question] = made
            return None, made, True

    def _answer(self, question: Hashable, ask: Callable[[], Answer], asked: Future[Answer]) -> None:
        era = self._era
        try:
            found = ask()
        except BaseException as error:  # noqa: BLE001 - it is raised where the answer is awaited
            self._end(question, asked)
            asked.set_exception(error)
            return
        with self._lock:
            if era == self._era:
                self._answers[question] = (time.monotonic(), found)
                self._answers.move_to_end(question)
            while len(self._answers) > MOST_KEPT:
                self._answers.popitem(last=False)
        self._end(question, asked)
        asked.set_result(found)

    def _end(self, question: Hashable, asked: Future[Answer]) -> None:
        with self._lock:
            if self._asked.get(question) is asked:
                del self._asked[question]
