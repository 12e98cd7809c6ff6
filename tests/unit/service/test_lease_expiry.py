"""Leases end with silent workers, not with a clock that was set or a service that heard nothing."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from schemas.work import RenewRequest
from service.background.clock_watch import ClockWatch
from service.background.lease_expiry import LEAST_GAP_S, LeaseExpiry
from service.errors import StateUnusableError
from service.store.engine import open_store
from tests.contracts.ledger_world import World

TERM_S = 30.0


class Fixture:
    """A ledger with one lease, and both clocks of its machine."""

    def __init__(self, world: World) -> None:
        self.world, self.steady_s, self.fails = world, 50.0, False
        world.listed("log")
        world.plan_all()
        self.lease = world.mine_lease()
        clock = ClockWatch(now_s=world.clock, steady_s=lambda: self.steady_s)
        self.expiry = LeaseExpiry(self, clock, lease_s=TERM_S, steady_s=lambda: self.steady_s)
        self.pass_time(1)

    def resume(self) -> None:
        if self.fails:
            raise StateUnusableError("away")
        self.world.ledger.resume()

    def expire(self) -> int:
        return self.world.ledger.expire()

    def set_clock(self, step_s: float) -> None:
        self.world.clock.now_s += step_s

    def let_pass(self, seconds: float) -> None:
        self.world.clock.now_s += seconds
        self.steady_s += seconds

    def pass_time(self, seconds: int) -> None:
        """Let seconds pass, at the end of each of which leases expire."""
        for _ in range(seconds):
            self.let_pass(1.0)
            self.expiry.expire()

    def renews(self) -> bool:
        request = RenewRequest(worker_id="w1", lease_id=self.lease.lease_id)
        return self.world.ledger.renew(request).ok


@pytest.fixture
def fixture(tmp_path: Path) -> Iterator[Fixture]:
    with closing(open_store(tmp_path)) as store:
        yield Fixture(World.on(store))


def test_a_silent_worker_loses_its_lease_after_a_term(fixture: Fixture) -> None:
    fixture.pass_time(int(TERM_S) - 2)
    assert fixture.renews()
    fixture.pass_time(int(TERM_S) + 1)
    assert not fixture.renews()


@pytest.mark.parametrize("step_s", [TERM_S + 1, 3600.0, -3600.0])
def test_a_clock_that_is_set_ends_no_lease_and_makes_none_eternal(
    fixture: Fixture, step_s: float
) -> None:
    fixture.set_clock(step_s)
    fixture.pass_time(1)
    assert fixture.renews()
    fixture.pass_time(int(TERM_S) + 1)
    assert not fixture.renews()


def test_a_clock_that_is_set_again_and_again_parks_no_work(fixture: Fixture) -> None:
    for _ in range(20):
        fixture.set_clock(3600.0)
        fixture.pass_time(1)
    assert fixture.renews()
    assert fixture.world.ledger.status().parked == ()


def test_a_service_that_heard_nothing_for_long_ends_no_lease(fixture: Fixture) -> None:
    fixture.let_pass(2 * TERM_S)
    fixture.pass_time(1)
    assert fixture.renews()


def test_a_short_gap_saves_no_dead_worker(fixture: Fixture) -> None:
    for _ in range(int(TERM_S / LEAST_GAP_S) + 2):
        fixture.let_pass(LEAST_GAP_S - 1.5)
        fixture.pass_time(1)
    assert not fixture.renews()


def test_a_step_is_not_forgotten_while_the_database_is_away(fixture: Fixture) -> None:
    fixture.set_clock(3600.0)
    fixture.fails = True
    with pytest.raises(StateUnusableError):
        fixture.pass_time(1)
    fixture.fails = False
    fixture.pass_time(1)
    assert fixture.renews()
