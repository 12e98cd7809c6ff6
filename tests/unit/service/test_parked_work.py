"""What the runbook says of parked work: what has it tried again, and what does not."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from schemas.work import Recording
from service.ledger import LeasePolicy, Ledger
from service.store.engine import open_store
from tests.contracts.ledger_world import World, recording


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    """A ledger with one log, mined but for one shard that is parked."""
    store = open_store(tmp_path)
    world = World.on(store)
    world.listed("a")
    world.plan_all()
    assert world.fail(world.mine_lease(), permanent=True).ok
    world.mine_all()
    assert parked(world) == 1
    yield world
    store.close()


def parked(world: World) -> int:
    """Count it as the metric does that the alert goes by."""
    return world.ledger.backlog().work.get(("shard", "parked"), 0)


def list_only(world: World, *found: Recording) -> None:
    world.ledger.sync_recordings(found)


def test_a_restart_with_more_attempts_changes_nothing(world: World) -> None:
    policy = LeasePolicy(max_attempts=50)
    world.ledger = Ledger(world.store, now_s=world.clock, policy=policy)
    world.ledger.resume()
    assert world.mine_all() == []
    assert parked(world) == 1


def test_the_same_object_taken_away_and_put_back_changes_nothing(world: World) -> None:
    list_only(world)
    assert parked(world) == 0
    list_only(world, recording("a"))
    assert world.mine_all() == []
    assert parked(world) == 1


def test_an_object_with_another_etag_is_mined_anew(world: World) -> None:
    list_only(world, recording("a", etag="touched"))
    assert len(world.mine_all()) == 3
    assert parked(world) == 0


def test_the_object_under_another_key_is_mined_as_another_log(world: World) -> None:
    list_only(world, recording("b"))
    assert world.mine_all() == [("b", 0), ("b", 1), ("b", 2)]
    assert parked(world) == 0


def test_a_new_pipeline_version_mines_everything_and_the_old_one_nothing_again(
    world: World,
) -> None:
    assert len(world.mine_all("p2")) == 3
    assert parked(world) == 0
    assert world.mine_all("p1") == []
    assert len(world.ledger.status("p1").parked) == 1
