"""Loops that wait out what may pass, and end loudly on what may not."""

from threading import Event

import pytest
import structlog.testing

from schemas.errors import (
    BucketRefusedError,
    BucketUnreachableError,
    PermanentError,
    TransientError,
)
from service import ticking
from service.ticking import tick


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ticking, "FIRST_RETRY_S", 0.001)
    monkeypatch.setattr(ticking, "MOST_RETRY_S", 0.002)


def test_trouble_that_passes_is_said_once_and_so_is_its_end() -> None:
    stop, times = Event(), 0

    def work() -> None:
        nonlocal times
        times += 1
        if times == 6:
            stop.set()
        if 2 <= times <= 4:
            raise TransientError("store away")

    with structlog.testing.capture_logs() as said:
        tick(work, what="listing", interval_s=0.001, stop=stop)
    assert [entry["event"] for entry in said] == ["trying again", "works again"]
    assert times == 6


def test_trouble_that_will_not_pass_ends_the_loop() -> None:
    def work() -> None:
        raise PermanentError("access denied")

    with pytest.raises(PermanentError, match="access denied"):
        tick(work, what="listing", interval_s=0.001, stop=Event())


def test_a_refusal_is_waited_out_where_it_may_pass_and_said_with_its_sentence() -> None:
    stop, times = Event(), 0

    def work() -> None:
        nonlocal times
        times += 1
        match times:
            case 1 | 2:
                raise BucketRefusedError("the store refuses these credentials")
            case 3 | 4:
                raise BucketUnreachableError("the store cannot be reached")
            case 5:
                stop.set()

    with structlog.testing.capture_logs() as said:
        tick(
            work,
            what="listing",
            interval_s=0.001,
            stop=stop,
            passing=(TransientError, BucketRefusedError),
        )
    assert [entry.get("problem", entry["event"]) for entry in said] == [
        "the store refuses these credentials",
        "the store cannot be reached",
        "works again",
    ]


def test_an_alarm_ends_the_wait_and_rings_once() -> None:
    stop, alarm, times = Event(), Event(), 0

    def work() -> None:
        nonlocal times
        times += 1
        if times == 3:
            stop.set()
        alarm.set()

    tick(work, what="publishing", interval_s=3600.0, stop=stop, alarm=alarm)
    assert times == 3
