"""Seconds per stage, although the stages draw on each other."""

from collections.abc import Iterator
from itertools import tee

from workers.stage_timing import StageClock


class Time:
    """Seconds that pass when a stage says so."""

    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_a_stage_is_not_charged_for_the_stages_it_draws_on() -> None:
    time = Time()
    clock = StageClock(time)

    def slow(items: Iterator[int], seconds: float) -> Iterator[int]:
        for item in items:
            time.now_s += seconds
            yield item

    read = clock.drawn("ingest", slow(iter(range(3)), 1.0))
    posed, again = tee(clock.drawn("odometry", slow(read, 10.0)))
    one = clock.drawn("supervised", slow(posed, 100.0))
    other = clock.drawn("selfsupervised", slow(again, 1000.0))
    with clock.stage("contradiction"):
        for _ in zip(one, other, strict=True):
            time.now_s += 0.5
    assert dict(clock.seconds) == {
        "ingest": 3.0,
        "odometry": 30.0,
        "supervised": 300.0,
        "selfsupervised": 3000.0,
        "contradiction": 1.5,
    }


def test_time_between_two_items_belongs_to_whoever_draws_them() -> None:
    time = Time()
    clock = StageClock(time)
    for _ in clock.drawn("contradiction", range(2)):
        time.now_s += 5.0
    assert clock.seconds["contradiction"] == 0.0
