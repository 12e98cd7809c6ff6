"""What the pages say of a whole daemon: while it starts, while it works, when a part has ended."""

import pytest

from schemas.errors import TransientError
from service.monitoring.readiness import Daemon


class Part:
    """A service, or a pool, of which the test says how it is."""

    def __init__(self) -> None:
        self.ended: Exception | None = None
        self.unready = ""

    def check(self) -> None:
        if self.ended is not None:
            raise self.ended

    check_alive = check

    def not_ready(self) -> dict[str, str]:
        return {"bucket": self.unready} if self.unready else {}

    def check_ready(self) -> None:
        self.check()
        if self.unready:
            raise TransientError(self.unready)


def test_until_a_daemon_is_up_it_lives_and_names_what_it_waits_for() -> None:
    daemon = Daemon(router="waiting for a router")
    daemon.check()
    assert daemon.not_ready() == {"router": "waiting for a router"}
    daemon.up(Part())
    assert daemon.not_ready() == {}


def test_a_daemon_is_as_ready_as_all_of_its_parts() -> None:
    service, pool = Part(), Part()
    daemon = Daemon()
    daemon.up(service, pool)
    daemon.check()
    assert daemon.not_ready() == {}
    service.unready, pool.unready = "not listed", "no worker is connected"
    assert daemon.not_ready() == {"bucket": "not listed", "workers": "no worker is connected"}


def test_a_daemon_lives_no_more_when_a_part_has_ended() -> None:
    service, pool = Part(), Part()
    daemon = Daemon()
    daemon.up(service, pool)
    pool.ended = TransientError("the pool watches no more")
    with pytest.raises(TransientError, match="watches no more"):
        daemon.check()
    assert daemon.not_ready() == {"workers": "the pool watches no more"}
    service.ended = LookupError("a bug")
    with pytest.raises(LookupError, match="a bug"):
        daemon.check()
