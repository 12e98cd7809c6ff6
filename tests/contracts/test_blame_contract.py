"""Deaths of workers: which count against their work, who gets that work next, on any database."""

from collections.abc import Callable

import pytest

from schemas.work import MineLease, NothingToDo, PlanLease
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World, expected_scenes
from tests.contracts.store_contract import StoreContract

HEALTHY = "worker-good-pool1-0"
LOGS = ("a", "b", "c")
LONG_S = 40.0
"""Longer than a doomed worker needs to start once more."""


def die(world: World, worker: str, *, after_s: float = 1.0) -> MineLease | PlanLease | None:
    """Let a worker claim and die; None where there is nothing for it."""
    grant = world.claim(worker)
    if isinstance(grant, NothingToDo):
        return None
    world.clock.now_s += after_s
    assert world.ledger.worker_died(worker) == 1
    return grant


def finish(world: World, worker: str) -> bool:
    """Let a worker claim and finish; false where there is nothing for it."""
    grant = world.claim(worker)
    if isinstance(grant, NothingToDo):
        return False
    world.clock.now_s += 1.0
    if isinstance(grant, PlanLease):
        return world.commit_plan(grant, worker).ok
    return world.commit_shard(grant, worker).ok


def mine_beside(world: World, doomed: Callable[[int], str], *, deaths: int) -> int:
    """Let one healthy worker mine everything while others die, so many for each of its works.

    Returns:
        How many died.
    """
    died = 0
    for _ in range(500):
        for _ in range(deaths):
            died += die(world, doomed(died)) is not None
            world.clock.now_s += LONG_S / deaths
        finish(world, HEALTHY)
        if world.ledger.settled("p1"):
            return died
    pytest.fail(f"no end after {died} deaths: {world.ledger.status()}")


def all_is_mined(world: World) -> bool:
    found = {scene.scene_id: scene.sha256 for scene in world.ledger.current_scenes()}
    return world.ledger.status().parked == () and found == expected_scenes(LOGS)


class BlameContract(StoreContract):
    def test_a_worker_that_dies_on_everything_parks_nothing(self, world: World) -> None:
        world.listed(*LOGS)
        assert mine_beside(world, lambda _: "worker-bad-pool2-0", deaths=6) > 5
        assert all_is_mined(world)

    def test_a_machine_on_which_every_worker_dies_parks_nothing(self, world: World) -> None:
        world.listed(*LOGS)
        assert mine_beside(world, lambda died: f"worker-bad-pool2-{died % 8}", deaths=8) > 5
        assert all_is_mined(world)

    def test_a_container_that_dies_with_its_pool_each_time_parks_nothing(
        self, world: World
    ) -> None:
        world.listed(*LOGS)
        assert mine_beside(world, lambda died: f"worker-bad-pool{died}-0", deaths=6) > 5
        assert all_is_mined(world)

    def test_a_shard_that_kills_healthy_workers_is_parked_and_the_rest_is_done(
        self, world: World
    ) -> None:
        world.listed(*LOGS)
        deaths = 0
        for number in range(200):
            worker = f"worker-good-pool1-{number % 2}"
            grant = world.claim(worker)
            world.clock.now_s += 10.0
            if isinstance(grant, MineLease) and (grant.shard.log_id, grant.shard.index) == ("a", 1):
                deaths += world.ledger.worker_died(worker)
            elif isinstance(grant, MineLease):
                assert world.commit_shard(grant, worker).ok
            elif isinstance(grant, PlanLease):
                assert world.commit_plan(grant, worker).ok
        assert deaths == 5
        assert world.ledger.settled("p1")
        (parked,) = world.ledger.status().parked
        assert (parked.log_id, parked.shard, parked.attempts) == ("a", "lidar-00001", 5)
        assert parked.error == "worker died 5 times while mining it"
        assert world.shards("done") == 8

    def test_where_everybody_dies_on_everything_there_is_an_end(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        deaths = 0
        for _ in range(200):
            deaths += die(world, "worker-bad-pool1-0") is not None
            world.clock.now_s += 10.0
        assert world.ledger.settled("p1")
        assert [work.error for work in world.ledger.status().parked] == [
            "worker died 10 times while mining it"
        ] * 3
        assert deaths == 30

    def test_work_rests_after_a_death_longer_each_time(self, world: World) -> None:
        world.listed("a")
        for rest_s in (2, 4, 8, 16):
            assert die(world, f"w-before-{rest_s}") is not None
            world.clock.now_s += rest_s - 0.5
            assert isinstance(world.claim("w2"), NothingToDo)
            world.clock.now_s += 0.5

    def test_work_that_ended_badly_waits_for_whoever_finishes_something(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        assert finish(world, HEALTHY)
        lease = die(world, "worker-bad-pool2-0")
        assert isinstance(lease, MineLease)
        world.clock.now_s += 2.0
        other = world.mine_lease("worker-bad-pool2-0")
        assert other.shard.index != lease.shard.index
        assert isinstance(world.claim("worker-bad-pool2-1"), NothingToDo)
        assert world.mine_lease(HEALTHY).shard.index == lease.shard.index

    def test_a_worker_that_has_not_died_has_a_head_start(self, world: World) -> None:
        world.listed("a")
        lease = die(world, "worker-bad-pool2-0")
        assert isinstance(lease, PlanLease)
        world.clock.now_s += 2.5
        held_back = world.claim("worker-bad-pool2-0")
        assert isinstance(held_back, NothingToDo)
        assert 0 < held_back.retry_after_s < 3
        assert isinstance(world.claim("worker-new-pool3-0"), PlanLease)

    def test_a_worker_alone_gets_its_work_after_the_head_start(self, world: World) -> None:
        world.listed("a")
        assert die(world, "worker-bad-pool2-0") is not None
        world.clock.now_s += 5.0
        assert isinstance(world.claim("worker-bad-pool2-0"), PlanLease)

    def test_work_that_ended_badly_waits_for_nobody_who_has_left(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        assert finish(world, HEALTHY)
        lease = die(world, "worker-bad-pool2-0")
        assert lease is not None
        world.clock.now_s += 95.0
        assert world.mine_lease("worker-bad-pool2-0") != lease

    def test_a_clock_that_steps_back_makes_nobody_wait(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        assert finish(world, HEALTHY)
        assert die(world, "worker-bad-pool2-0") is not None
        world.clock.now_s -= 86_400.0
        assert world.mine_lease("worker-bad-pool2-0").shard.index == 1

    def test_work_that_is_retried_has_all_of_its_deaths_again(self, world: World) -> None:
        world.listed("a")
        for _ in range(2):
            for _ in range(5):
                assert world.ledger.status().parked == ()
                assert die(world, "w1") is not None
                world.clock.now_s += 100.0
            (parked,) = world.ledger.retry()
            assert parked.error == "worker died 5 times while planning it"


class TestBlameOnSqlite(OnSqlite, BlameContract):
    pass


@pytest.mark.integration
class TestBlameOnPostgres(OnPostgres, BlameContract):
    pass
