"""The service's clock steps by an hour: nothing is parked, and nothing waits for the hour."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from schemas.work import MineLease, NothingToDo, PlanLease, RenewRequest
from service.store.engine import open_store
from tests.contracts.ledger_world import World, expected_scenes

HOUR_S = 3600.0
SETTLE_S = 30.0


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    store = open_store(tmp_path)
    yield World.on(store, settle_s=SETTLE_S)
    store.close()


@pytest.fixture
def settled(world: World) -> World:
    """A world whose one log is planned."""
    world.listed("a")
    world.clock.now_s += SETTLE_S
    world.plan_all()
    return world


@pytest.mark.parametrize("step_s", [HOUR_S, -HOUR_S], ids=["forward", "back"])
def test_a_lease_that_is_renewed_survives_a_step(settled: World, step_s: float) -> None:
    lease = settled.mine_lease()
    settled.clock.now_s += step_s
    renewed = settled.ledger.renew(RenewRequest(worker_id="w1", lease_id=lease.lease_id))
    assert renewed.ok
    assert settled.ledger.expire() == 0
    assert settled.commit_shard(lease).ok


def test_after_a_step_forward_a_late_commit_is_taken(settled: World) -> None:
    lease = settled.mine_lease()
    settled.clock.now_s += HOUR_S
    assert settled.ledger.expire() == 1
    assert settled.commit_shard(lease).ok
    settled.mine_all()
    assert set(settled.ids()) == set(expected_scenes(["a"]))
    assert settled.ledger.status().parked == ()


def test_after_a_step_back_a_dead_workers_lease_ends_within_a_term(settled: World) -> None:
    lease = settled.mine_lease()
    settled.clock.now_s -= HOUR_S
    assert settled.ledger.expire() == 0
    settled.clock.now_s += lease.expires_s
    assert settled.ledger.expire() == 1
    settled.clock.now_s += 2  # work whose worker has died rests
    again = settled.mine_lease("w2")
    assert again.shard == lease.shard


def test_after_a_step_back_work_does_not_rest_for_an_hour(settled: World) -> None:
    lease = settled.mine_lease()
    settled.fail(lease)
    settled.clock.now_s -= HOUR_S
    names = set()
    while isinstance(grant := settled.claim(), MineLease):
        names.add(grant.shard.name)
    assert lease.shard.name in names


def test_after_a_step_back_a_growing_log_settles_in_its_time(world: World) -> None:
    world.listed("a")
    world.clock.now_s -= HOUR_S
    lease = world.plan_lease()
    assert not lease.settled
    assert world.fail(lease, growing=True).ok
    assert isinstance(world.claim(), NothingToDo)
    world.clock.now_s += SETTLE_S
    assert world.plan_lease().settled


def test_a_step_back_leaves_the_rate_of_frames_positive(settled: World) -> None:
    settled.mine_all()
    for step_s in (-HOUR_S, HOUR_S, 1.0):
        settled.clock.now_s += step_s
        assert settled.ledger.status().frames_per_s >= 0.0


def test_steps_while_mining_change_no_scene_and_park_nothing(world: World) -> None:
    world.listed("a", "b", "c")
    steps = [HOUR_S, -HOUR_S, -HOUR_S, HOUR_S]
    world.clock.now_s += SETTLE_S
    done = 0
    while not isinstance(grant := world.claim(), NothingToDo):
        world.clock.now_s += steps[done % len(steps)]
        world.ledger.expire()
        done += 1
        if isinstance(grant, PlanLease):
            assert world.commit_plan(grant).ok
        else:
            assert world.commit_shard(grant).ok
    assert world.ledger.status().parked == ()
    assert set(world.ids()) == set(expected_scenes(["a", "b", "c"]))
