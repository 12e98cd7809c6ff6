"""The steps of the stream by name: a clock can watch them, and they need not know."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import ParamSpec, TypeVar

Watch = Callable[[str], AbstractContextManager[None]]
"""Enters a step by its name, and leaves it."""

Given = ParamSpec("Given")
Answer = TypeVar("Answer")

_WATCH: ContextVar[Watch | None] = ContextVar("watch", default=None)


def step(name: str) -> Callable[[Callable[Given, Answer]], Callable[Given, Answer]]:
    """Name a function as a step; unwatched it is called as it is."""

    def named(function: Callable[Given, Answer]) -> Callable[Given, Answer]:
        @wraps(function)
        def seen(*args: Given.args, **kwargs: Given.kwargs) -> Answer:
            watch = _WATCH.get()
            if watch is None:
                return function(*args, **kwargs)
            with watch(name):
                return function(*args, **kwargs)

        return seen

    return named


@contextmanager
def watched(watch: Watch) -> Iterator[None]:
    """Let a clock watch every step that is taken inside, in this thread."""
    before = _WATCH.set(watch)
    try:
        yield
    finally:
        _WATCH.reset(before)
