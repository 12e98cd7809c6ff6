"""What the runbook says of parked work: what has it tried again, and what does not."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from schemas.work import Recording
from service.cli.main import main
from service.monitoring.metrics import ServiceMetrics
from service.store.engine import open_store
from service.store.ledger import LeasePolicy, Ledger
from service.store.state import StateLock
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


def test_the_verb_has_it_tried_again_by_the_next_run(
    world: World, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    at = ["--state", str(tmp_path)]
    assert main(["retry", "a", "--json", *at]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["log_id"], told["attempts"], told["error"]) == ("a", 1, "cannot read chunk")
    assert main(["status", *at]) == 0
    assert f"tried again: a {told['shard']}; before that: cannot read chunk" in said(capsys)
    assert main(["retry", "a", *at]) == 0
    told = said(capsys)
    assert "nothing of a is parked or refused" in told
    assert "another answer of the model needs a folder of its own" in told
    assert main(["retry", "--all", *at]) == 0
    assert "nothing is parked" in said(capsys)
    assert len(world.mine_all()) == 1


def test_the_verb_wants_logs_or_all_and_refuses_strangers(
    world: World, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    at = ["--state", str(tmp_path)]
    for wrong in ([], ["a", "--all"]):
        assert main(["retry", *wrong, *at]) == 1
        assert "name the logs to retry, or give --all" in said(capsys)
    assert main(["retry", "a", "stranger", *at]) == 1
    assert "no such log in the bucket: 'stranger'" in said(capsys)
    assert parked(world) == 1


def test_beside_a_service_only_the_service_has_it_tried_again(
    world: World, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with StateLock(tmp_path, endpoint="tcp/127.0.0.1:7447"):
        assert main(["retry", "--all", "--state", str(tmp_path)]) == 1
    assert "alone may retry: use --connect tcp/127.0.0.1:7447" in said(capsys)
    assert parked(world) == 1


def test_what_is_tried_again_is_counted(world: World) -> None:
    metrics = ServiceMetrics()
    world.ledger.observe(metrics)
    world.ledger.retry()
    world.ledger.retry()
    counted = metrics.registry.get_sample_value
    assert counted("counterpoint_work_retried_total", {"work": "shard"}) == 1
    assert counted("counterpoint_work_retried_total", {"work": "plan"}) == 0


def said(capsys: pytest.CaptureFixture[str]) -> str:
    return capsys.readouterr().err
