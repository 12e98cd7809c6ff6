"""Parked work that is tried again: what opens, what stays as it is, on any database."""

from abc import ABC, abstractmethod
from collections.abc import Iterator

import pytest

from schemas.work import Damage, LogPlan, MineLease, PlanLease
from service.curation.status import ParkedWork
from service.errors import NothingFoundError
from service.store.engine import Store
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World, expected_scenes, plan_of, recording


def park(world: World, lease: PlanLease | MineLease) -> None:
    assert world.fail(lease, permanent=True).ok


def two_logs_with_a_shard_parked_in_each(world: World) -> None:
    world.listed("a", "b")
    world.plan_all()
    while isinstance(lease := world.claim(), MineLease):
        if lease.shard.index == 1:
            park(world, lease)
        else:
            assert world.commit_shard(lease).ok
    assert world.shards("parked") == 2


class RetryContract(ABC):
    @abstractmethod
    def make_store(self) -> Store: ...

    @pytest.fixture
    def world(self) -> Iterator[World]:
        world = World.on(self.make_store())
        yield world
        world.store.close()

    def test_parked_shards_are_mined_and_nothing_else_is(self, world: World) -> None:
        two_logs_with_a_shard_parked_in_each(world)
        assert [(work.log_id, work.shard, work.attempts) for work in world.ledger.retry()] == [
            ("a", "lidar-00001", 1),
            ("b", "lidar-00001", 1),
        ]
        assert world.mine_all() == [("a", 1), ("b", 1)]
        scenes = {scene.scene_id: scene.sha256 for scene in world.ledger.current_scenes()}
        assert scenes == expected_scenes(["a", "b"])
        assert world.ledger.last_seq() == len(scenes)

    def test_only_that_of_the_logs_that_are_named(self, world: World) -> None:
        two_logs_with_a_shard_parked_in_each(world)
        (retried,) = world.ledger.retry(["b", "b"])
        assert retried == ParkedWork(
            log_id="b", shard="lidar-00001", attempts=1, error="cannot read chunk"
        )
        assert world.mine_all() == [("b", 1)]
        assert [work.log_id for work in world.ledger.status().parked] == ["a"]

    def test_asked_again_nothing_is_opened_again(self, world: World) -> None:
        two_logs_with_a_shard_parked_in_each(world)
        assert len(world.ledger.retry()) == 2
        held = world.mine_lease()
        assert world.ledger.retry() == []
        assert world.ledger.retry(["a"]) == []
        assert world.commit_shard(held).ok
        assert world.mine_all() == [("b", 1)]
        assert world.ledger.retry() == []

    def test_a_log_that_is_not_in_the_bucket_is_named_and_nothing_is_changed(
        self, world: World
    ) -> None:
        two_logs_with_a_shard_parked_in_each(world)
        with pytest.raises(NothingFoundError, match=r"no such log in the bucket: 'x', 'y';"):
            world.ledger.retry(["y", "a", "x"])
        assert world.shards("parked") == 2
        with pytest.raises(NothingFoundError, match=r"'l0', 'l1', 'l2', 'l3', 'l4' and 2 more"):
            world.ledger.retry([f"l{number}" for number in range(7)])

    def test_it_has_all_of_its_attempts_again_and_is_parked_after_them(self, world: World) -> None:
        world.listed("a")
        for _ in range(5):
            world.clock.now_s += 100
            assert world.fail(world.plan_lease()).ok
        assert world.ledger.retry()[0].attempts == 5
        for _ in range(5):
            assert world.ledger.status().parked == ()
            assert world.fail(world.plan_lease()).ok  # the first one at once: it rests no more
            world.clock.now_s += 100
        assert [work.attempts for work in world.ledger.status().parked] == [5]
        assert world.ledger.retry(["a"])[0].attempts == 5

    def test_a_parked_plan_is_made_and_mined(self, world: World) -> None:
        world.listed("a")
        park(world, world.plan_lease())
        assert [work.shard for work in world.ledger.retry(["a"])] == [""]
        assert world.ledger.backlog().recordings["waiting"] == 1
        assert len(world.mine_all()) == 3
        assert world.ledger.status().logs_by_state == {"done": 1}

    def test_a_refused_log_is_planned_again_where_it_is_asked_for(self, world: World) -> None:
        bent = Damage(key="x.mcap", offset=4, bytes=8, what="CRC differs")
        answer = "no predictions for it"

        def plan(log_id: str, *, refused: str) -> LogPlan:
            made = plan_of(log_id, shards=2, refused=refused)
            return made.model_copy(update={"damage": (bent,)})

        world.planner = lambda recording: plan(recording.log_id, refused=answer)
        world.listed("a", "b", "c")
        assert world.mine_all() == []
        assert world.ledger.retry() == [], "refused is not parked"
        assert world.ledger.status().logs_by_state == {"refused": 3}
        assert [work.error for work in world.ledger.retry(["b"])] == [answer]
        assert world.mine_all() == []
        assert world.ledger.status().logs_by_state == {"refused": 3}, "nothing came meanwhile"
        world.planner = lambda recording: plan(recording.log_id, refused="")
        assert [work.log_id for work in world.ledger.retry(refused=True)] == ["a", "b", "c"]
        assert world.ledger.retry(refused=True) == []
        world.mine_all()
        status = world.ledger.status()
        assert status.logs_by_state == {"done": 3}
        assert {log.log_id: log.damage for log in status.logs} == dict.fromkeys("abc", (bent,))
        scenes = {scene.scene_id: scene.sha256 for scene in world.ledger.current_scenes()}
        assert scenes == expected_scenes(["a", "b", "c"], shards=2)

    def test_status_says_what_is_tried_again_until_it_is_done_or_fails(self, world: World) -> None:
        two_logs_with_a_shard_parked_in_each(world)
        assert world.ledger.status().retried == ()
        world.ledger.retry()
        status = world.ledger.status()
        assert status.parked == ()
        assert [(work.log_id, work.error) for work in status.retried] == [
            ("a", "cannot read chunk"),
            ("b", "cannot read chunk"),
        ]
        assert ("shard", "parked") not in world.ledger.backlog().work
        assert world.commit_shard(world.mine_lease()).ok
        assert [work.log_id for work in world.ledger.status().retried] == ["b"]
        assert world.fail(world.mine_lease()).ok
        assert world.ledger.status().retried == ()

    def test_work_of_a_recording_that_was_replaced_stays_as_it_is(self, world: World) -> None:
        two_logs_with_a_shard_parked_in_each(world)
        world.ledger.sync_recordings([recording("a", etag="b"), recording("b")])
        assert [work.log_id for work in world.ledger.retry()] == ["b"]
        world.mine_all()
        world.listed("a", "b")  # the first `a` is back, and still parked
        assert [work.log_id for work in world.ledger.status().parked] == ["a"]
        assert [work.log_id for work in world.ledger.retry()] == ["a"]

    def test_that_of_an_older_pipeline_version_stays_as_it_is(self, world: World) -> None:
        two_logs_with_a_shard_parked_in_each(world)
        world.mine_all("p2")
        assert world.ledger.retry() == []
        assert len(world.ledger.status("p1").parked) == 2

    def test_it_is_on_disk(self, world: World) -> None:
        two_logs_with_a_shard_parked_in_each(world)
        world.ledger.retry(["a"])
        world.store.close()
        world.store = self.make_store()
        again = World.on(world.store, clock=world.clock)
        assert [work.log_id for work in again.ledger.status().retried] == ["a"]
        assert again.mine_all() == [("a", 1)]


class TestRetryOnSqlite(OnSqlite, RetryContract):
    pass


@pytest.mark.integration
class TestRetryOnPostgres(OnPostgres, RetryContract):
    pass
