"""Answers that several pages need within seconds, each asked once and kept for a while."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Final, Generic, TypeVar

Answer = TypeVar("Answer")

MOST_KEPT: Final = 50
"""Answers of one kind that are kept; the oldest is dropped."""


class Kept(Generic[Answer]):
    """Answers by question, each asked by one thread at a time."""

    def __init__(self, *, age_s: float) -> None:
        """Keep answers up to an age, seconds."""
        self._age_s = age_s
        self._lock = threading.Lock()
        self._answers: OrderedDict[Hashable, tuple[float, Answer]] = OrderedDict()
        self._asking: dict[Hashable, threading.Lock] = {}

    def of(self, question: Hashable, ask: Callable[[], Answer]) -> Answer:
        """Return the kept answer, else that of `ask`; what it raises is not kept."""
        with self._lock:
            asking = self._asking.setdefault(question, threading.Lock())
        with asking:
            with self._lock:
                kept = self._answers.get(question)
            if kept is not None and time.monotonic() - kept[0] < self._age_s:
                return kept[1]
            found = ask()
            with self._lock:
                self._answers[question] = (time.monotonic(), found)
                self._answers.move_to_end(question)
                while len(self._answers) > MOST_KEPT:
                    dropped, _ = self._answers.popitem(last=False)
                    self._asking.pop(dropped, None)
        return found

    def forget(self) -> None:
        """Ask again next time."""
        with self._lock:
            self._answers.clear()
