"""Waits before trying again."""

from collections.abc import Callable
from itertools import islice
from threading import Event

import numpy as np
import pytest

from schemas.errors import TransientError
from schemas.runtime.retry import StoppedError, backoff_s, pause


def test_waits_double_up_to_the_longest_and_are_shortened_by_half_at_most() -> None:
    waits = list(islice(backoff_s(first_s=0.02, most_s=0.5, uniform=_drawn(1)), 12))
    full = [0.02, 0.04, 0.08, 0.16, 0.32, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]
    assert all(f / 2 <= wait <= f for wait, f in zip(waits, full, strict=True))


def test_two_who_wait_do_not_march_in_step() -> None:
    one = list(islice(backoff_s(first_s=1, most_s=8, uniform=_drawn(1)), 6))
    other = list(islice(backoff_s(first_s=1, most_s=8, uniform=_drawn(2)), 6))
    assert all(a != b for a, b in zip(one, other, strict=True))


def test_whoever_is_told_to_stop_waits_no_longer() -> None:
    stop = Event()
    pause(stop, 0.001)
    stop.set()
    with pytest.raises(StoppedError):
        pause(stop, 3600.0)
    assert issubclass(StoppedError, TransientError)


def _drawn(seed: int) -> Callable[[float, float], float]:
    return np.random.default_rng(seed).uniform
