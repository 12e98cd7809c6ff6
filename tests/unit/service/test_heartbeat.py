"""A daemon is never silent for long, and never says more than a line a minute of how it stands."""

from collections.abc import Iterator

import pytest
import structlog
from structlog.testing import capture_logs

from service.background.heartbeat import Heartbeat, Standing


class Daemon:
    """A clock that is moved by hand, and something to say."""

    def __init__(self, *, heartbeat_s: float = 300.0) -> None:
        self.now_s, self.asked = 0.0, 0
        self.stands: dict[str, int | float | None] = {"scenes": 0, "listed_ago_s": 3}
        self.heartbeat = Heartbeat(
            self._standing, heartbeat_s=heartbeat_s, clock_s=lambda: self.now_s
        )

    def _standing(self) -> Standing:
        self.asked += 1
        return dict(self.stands)

    def lives(self, seconds: int, *, scenes_each: int = 0) -> list[tuple[float, str, object]]:
        """Beat every five seconds; return when which line was said, and its number of scenes."""
        said = []
        with capture_logs() as lines:
            for _ in range(seconds // 5):
                self.now_s += 5
                self.stands["scenes"] = int(self.stands["scenes"] or 0) + scenes_each
                self.stands["listed_ago_s"] = self.now_s
                self.heartbeat.beat()
                said += [(self.now_s, line["event"], line["scenes"]) for line in lines]
                lines.clear()
        return said


@pytest.fixture(autouse=True)
def _plain_logging() -> Iterator[None]:
    structlog.reset_defaults()
    yield
    structlog.reset_defaults()


def test_a_quiet_daemon_says_so_at_every_heartbeat() -> None:
    daemon = Daemon()
    assert daemon.lives(1000) == [(300, "quiet", 0), (600, "quiet", 0), (900, "quiet", 0)]


def test_a_busy_daemon_sums_up_each_minute_once() -> None:
    assert Daemon().lives(185, scenes_each=2) == [
        (60, "busy", 24),
        (120, "busy", 48),
        (180, "busy", 72),
    ]


def test_what_happened_is_said_a_minute_later_and_then_it_is_quiet() -> None:
    daemon = Daemon()
    daemon.lives(300)
    daemon.stands["scenes"] = 7
    assert daemon.lives(400) == [(360, "busy", 7), (660, "quiet", 7)]


def test_the_line_says_what_is_new() -> None:
    daemon = Daemon()
    daemon.lives(60, scenes_each=1)
    with capture_logs() as lines:
        daemon.now_s, daemon.stands["scenes"] = 121, 30
        daemon.heartbeat.beat()
    assert [(line["scenes"], line["new_scenes"]) for line in lines] == [(30, 18)]


def test_scenes_that_went_are_said_as_withdrawn() -> None:
    daemon = Daemon()
    daemon.lives(60, scenes_each=1)
    with capture_logs() as lines:
        daemon.now_s, daemon.stands["scenes"] = 121, 9
        daemon.heartbeat.beat()
    assert [(line["withdrawn_scenes"], "new_scenes" in line) for line in lines] == [(3, False)]


@pytest.mark.parametrize(
    "what", ["logs_waiting", "logs_growing", "shards_waiting", "shards_leased"]
)
def test_a_daemon_with_work_is_not_called_quiet_while_nothing_is_finished(what: str) -> None:
    daemon = Daemon()
    daemon.stands[what] = 1
    assert {event for _, event, _ in daemon.lives(1000)} == {"busy"}


def test_a_short_heartbeat_is_kept() -> None:
    daemon = Daemon(heartbeat_s=10)
    assert [when for when, _, _ in daemon.lives(30)] == [10, 20, 30]
    assert daemon.heartbeat.interval_s == 5


def test_how_things_stand_is_only_asked_when_a_line_may_be_due() -> None:
    daemon = Daemon()
    daemon.lives(55)
    assert daemon.asked == 0
