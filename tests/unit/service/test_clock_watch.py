"""A clock that is set is said and counted; one that is kept right, or a slow look, is not."""

from structlog.testing import capture_logs

from service.background.clock_watch import GLANCE_S, STEP_S, ClockWatch


class Clocks:
    """The world's clock, and one that cannot be set."""

    def __init__(self) -> None:
        self.steady_s, self.ahead_s, self.glance_s = 100.0, 1.7e9, 0.0
        self.watch = ClockWatch(now_s=lambda: self.steady_s + self.ahead_s, steady_s=self._steady)

    def _steady(self) -> float:
        self.steady_s += self.glance_s
        return self.steady_s

    def look(self, after_s: float = 1.0) -> None:
        self.steady_s += after_s
        self.watch.look()


def test_a_clock_that_is_set_is_said_once_and_counted_by_direction() -> None:
    clocks = Clocks()
    with capture_logs() as said:
        clocks.look()
        clocks.ahead_s -= 3600
        clocks.look()
        clocks.look()
        clocks.ahead_s += 3600
        clocks.look()
    assert [each["step_s"] for each in said] == [-3600.0, 3600.0]
    assert clocks.watch.steps == {"forward": 1, "back": 1}


def test_a_clock_that_is_kept_right_is_no_step_however_long_between_two_looks() -> None:
    clocks = Clocks()
    clocks.look()
    for _ in range(100):
        clocks.ahead_s += STEP_S * 0.9
        clocks.look(after_s=3600)
    assert clocks.watch.steps == {"forward": 0, "back": 0}


def test_a_look_that_was_interrupted_says_nothing_and_the_next_one_does() -> None:
    clocks = Clocks()
    clocks.look()
    clocks.ahead_s -= 10
    clocks.glance_s = 2 * GLANCE_S
    clocks.look()
    assert clocks.watch.steps["back"] == 0
    clocks.glance_s = 0.0
    clocks.look()
    assert clocks.watch.steps["back"] == 1
