"""Overlays of withdrawn scenes: since when they count, and which may go, on any database."""

import pytest
from sqlalchemy import select

from schemas.work import MineLease
from service.store.retirement import SceneOverlay
from service.store.tables import SCENES
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World, plan_of_parts, recording, split
from tests.contracts.store_contract import StoreContract

DAY_S = 86_400.0
KEEP_S = 7 * DAY_S


def due(world: World) -> list[SceneOverlay]:
    """Sweep's look at the ledger: note, and say what may go."""
    world.ledger.retired_overlays.note()
    return sorted(world.ledger.retired_overlays.to_delete(keep_s=KEEP_S, limit=1000))


def of_scenes(world: World, *, current: bool) -> list[SceneOverlay]:
    names = (SCENES.c.log_id, SCENES.c.scene_id, SCENES.c.pipeline_version, SCENES.c.sha256)
    with world.store.reading() as connection:
        rows = connection.execute(select(*names).where(SCENES.c.is_current == current))
        return sorted({SceneOverlay(*row) for row in rows})


class RetirementContract(StoreContract):
    def test_what_is_current_is_never_named(self, world: World) -> None:
        world.listed("a", "b")
        world.mine_all()
        assert due(world) == []
        world.clock.now_s += 1000 * DAY_S
        assert due(world) == []

    def test_of_a_deleted_log_all_may_go_once_it_is_long_enough_ago(self, world: World) -> None:
        world.listed("a", "b")
        world.mine_all()
        world.listed("b")
        assert due(world) == []
        world.clock.now_s += KEEP_S - 1
        assert due(world) == []
        world.clock.now_s += 1
        may_go = due(world)
        assert may_go == of_scenes(world, current=False)
        assert {each.log_id for each in may_go} == {"a"}
        assert len(may_go) == 9

    def test_portions_are_the_oldest_and_what_is_gone_is_not_named_again(
        self, world: World
    ) -> None:
        world.listed("a", "b", "c")
        world.mine_all()
        for left in (("a", "c"), ("a",)):
            world.listed(*left)
            world.ledger.retired_overlays.note()
            world.clock.now_s += DAY_S
        world.clock.now_s += KEEP_S
        first = world.ledger.retired_overlays.to_delete(keep_s=KEEP_S, limit=9)
        assert {each.log_id for each in first} == {"b"}
        world.ledger.retired_overlays.note_deleted(first)
        rest = world.ledger.retired_overlays.to_delete(keep_s=KEEP_S, limit=1000)
        assert {each.log_id for each in rest} == {"c"}
        world.ledger.retired_overlays.note_deleted(rest)
        assert due(world) == []

    def test_a_log_that_comes_back_begins_to_count_anew_when_it_goes_again(
        self, world: World
    ) -> None:
        world.listed("a", "b")
        world.mine_all()
        world.listed("b")
        assert due(world) == []
        world.clock.now_s += KEEP_S
        world.listed("a", "b")
        assert due(world) == []
        world.listed("b")
        assert due(world) == []
        world.clock.now_s += KEEP_S - 1
        assert due(world) == []
        world.clock.now_s += 1
        assert len(due(world)) == 9

    def test_what_was_deleted_counts_again_when_it_was_mined_in_between(self, world: World) -> None:
        world.listed("a", "b")
        world.mine_all()
        for _ in range(2):
            world.listed("b")
            assert due(world) == []
            world.clock.now_s += KEEP_S
            gone = due(world)
            assert len(gone) == 9
            world.ledger.retired_overlays.note_deleted(gone)
            world.listed("a", "b")
            assert due(world) == []
            world.clock.now_s += 1.0
            assert len(world.ledger.retry(["a"])) == 3
            assert len(world.mine_all()) == 3
            assert due(world) == []

    def test_of_an_older_pipeline_version_all_may_go_when_the_newer_one_has_mined_the_log(
        self, world: World
    ) -> None:
        world.listed("a", "b")
        world.mine_all("p1")
        world.plan_all("p2")
        for _ in range(3):
            lease = world.mine_lease(version="p2")
            assert lease.shard.log_id == "a"
            assert world.commit_shard(lease, version="p2").ok
        left = world.mine_lease(version="p2")
        assert due(world) == []
        world.clock.now_s += KEEP_S
        may_go = due(world)
        assert {(each.log_id, each.pipeline_version) for each in may_go} == {("a", "p1")}
        assert len(may_go) == 9
        retired = world.ledger.retired_overlays
        assert retired.to_delete(keep_s=KEEP_S, limit=100, keep_pipelines=["p1"]) == []
        others = retired.to_delete(keep_s=KEEP_S, limit=100, keep_pipelines=["p1_", "p2"])
        assert sorted(others) == may_go
        assert world.commit_shard(left, version="p2").ok
        world.mine_all("p2")
        world.ledger.retired_overlays.note()
        world.clock.now_s += KEEP_S
        assert {each.log_id for each in due(world)} == {"a", "b"}

    def test_a_log_that_is_worked_on_or_parked_in_part_keeps_all(self, world: World) -> None:
        world.listed("a")
        world.mine_all()
        world.ledger.sync_recordings([recording("a", etag="b")])
        assert world.commit_plan(world.plan_lease()).ok  # the scenes of the one before go now
        world.ledger.retired_overlays.note()
        world.clock.now_s += KEEP_S
        assert due(world) == []
        while isinstance(lease := world.claim(), MineLease):
            assert due(world) == []
            if lease.shard.index == 2:
                assert world.fail(lease, permanent=True).ok
            else:
                assert world.commit_shard(lease).ok
        assert due(world) == []
        world.ledger.retry()
        world.mine_all()
        assert due(world) == [], "it was mined to the same records, which are current"

    def test_a_record_that_two_revisions_share_is_needed_while_either_is_current(
        self, world: World
    ) -> None:
        world.planner = plan_of_parts
        world.ledger.sync_recordings([split("a", "1", "2")])
        world.mine_all()
        world.ledger.sync_recordings([split("a", "1", "3")])
        world.mine_all()
        assert due(world) == []
        world.clock.now_s += KEEP_S
        may_go = due(world)
        current = of_scenes(world, current=True)
        assert len(may_go) == 3, "those of the second part"
        assert not set(may_go) & set(current)
        assert len(current) == 6

    def test_many_are_noted_in_portions(
        self, world: World, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("service.store.retired_overlays.AT_ONCE", 4)
        world.listed("a", "b")
        world.mine_all()
        world.listed("b")
        assert due(world) == []
        world.clock.now_s += KEEP_S
        assert len(due(world)) == 9

    def test_a_clock_that_is_set_back_only_keeps_for_longer(self, world: World) -> None:
        world.listed("a", "b")
        world.mine_all()
        world.listed("b")
        assert due(world) == []
        world.clock.now_s -= 30 * DAY_S
        assert due(world) == []
        world.clock.now_s += 30 * DAY_S + KEEP_S
        assert len(due(world)) == 9


class TestRetirementOnSqlite(OnSqlite, RetirementContract):
    pass


@pytest.mark.integration
class TestRetirementOnPostgres(OnPostgres, RetirementContract):
    pass
