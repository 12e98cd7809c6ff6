"""Exponential backoff with jitter."""

import random
from collections.abc import Callable, Iterator
from threading import Event

from schemas.errors import TransientError


def backoff_s(
    *, first_s: float, most_s: float, uniform: Callable[[float, float], float] = random.uniform
) -> Iterator[float]:
    """Yield waits that double from `first_s` to `most_s`, each shortened by up to half at random.

    Args:
        first_s: First wait, seconds, before jitter.
        most_s: Longest wait, seconds, before jitter.
        uniform: Draws the jitter; no result depends on it, so it needs no seed.
    """
    wait_s = first_s
    while True:
        yield wait_s * uniform(0.5, 1.0)
        wait_s = min(most_s, wait_s * 2)


class StoppedError(TransientError):
    """A wait was ended by the stop event."""


def pause(stop: Event, wait_s: float) -> None:
    """Wait for a time, or until the stop event is set.

    Raises:
        StoppedError: As soon as `stop` is set.
    """
    if stop.wait(wait_s):
        raise StoppedError("stopped while waiting; start again to go on")
