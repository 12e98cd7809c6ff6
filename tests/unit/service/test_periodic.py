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
from service.background import periodic
from service.background.periodic import tick
from service.errors import StateUnusableError


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(periodic, "FIRST_RETRY_S", 0.001)
    monkeypatch.setattr(periodic, "MOST_RETRY_S", 0.002)


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
        raise StateUnusableError("not a database")

    with pytest.raises(StateUnusableError, match="not a database"):
        tick(work, what="listing", interval_s=0.001, stop=Event())


class Panic(BaseException):
    """What the binding of Zenoh raises is no `Exception` either."""


@pytest.mark.parametrize("error", [ValueError("no such thing"), PermanentError("no"), Panic("!")])
def test_what_nobody_foresaw_is_logged_and_counted_and_the_work_goes_on(
    error: BaseException,
) -> None:
    stop, times, faults = Event(), 0, 0

    def work() -> None:
        nonlocal times
        times += 1
        if times == 4:
            stop.set()
        elif times > 1:
            raise error

    def count() -> None:
        nonlocal faults
        faults += 1

    with structlog.testing.capture_logs() as said:
        tick(work, what="publishing", interval_s=0.001, stop=stop, on_fault=count)
    assert faults == 2
    assert [entry["log_level"] for entry in said] == ["error", "error", "info"]
    assert said[0]["exc_info"] is error


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
