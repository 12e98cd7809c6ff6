"""Names of the stream's steps: a clock can time them, and the steps do not depend on it."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import ParamSpec, TypeVar

Watch = Callable[[str], AbstractContextManager[None]]
"""Context manager of a step, by its name."""

Given = ParamSpec("Given")
Answer = TypeVar("Answer")

_WATCH: ContextVar[Watch | None] = ContextVar("watch", default=None)


def step(name: str) -> Callable[[Callable[Given, Answer]], Callable[Given, Answer]]:
    """Name a function as a step; without a clock it is called directly."""

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
    """Let a clock time every step inside the context, in this thread."""
    before = _WATCH.set(watch)
    try:
        yield
    finally:
        _WATCH.reset(before)
