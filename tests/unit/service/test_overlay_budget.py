"""Disk budget of overlays: what goes first, what never goes, and how it comes back."""

from collections.abc import Iterator
from pathlib import Path
from threading import Event

import pytest

from schemas.transport.bucket import Bucket, open_bucket
from schemas.verdict import Verdict
from schemas.work import MineLease
from service.api.stored_overlays import key_of, open_stored_overlay, read_overlay
from service.background.overlay_budget import OverlayBudget
from service.curation.verdicts import JudgeRequest
from service.errors import NothingFoundError, UsageError
from service.store.engine import open_store
from tests.contracts.ledger_world import World

LOGS = "file:///somewhere/logs"
BYTES = 10


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    (tmp_path / "state").mkdir()
    store = open_store(tmp_path / "state")
    yield World.on(store)
    store.close()


@pytest.fixture
def artifacts(tmp_path: Path) -> Bucket:
    return open_bucket(str(tmp_path / "artifacts"), create=True)


def mine(world: World, artifacts: Bucket, *log_ids: str) -> None:
    """Mine these logs, and write the overlay of every scene as workers do."""
    world.listed(*log_ids)
    world.mine_all()
    for scene in world.ledger.current_scenes():
        artifacts.put(key_of(scene), b"x" * BYTES)


def budget_of(world: World, artifacts: Bucket, overlays: int) -> OverlayBudget:
    return OverlayBudget(
        artifacts, world.ledger, budget_bytes=BYTES * overlays, log_bucket_url=LOGS
    )


def kept(world: World, artifacts: Bucket) -> list[float]:
    """Scores of the current scenes that have their overlays, best first."""
    return [
        row.score
        for row in world.ledger.ranking()
        if (scene := world.ledger.scene(row.scene_id)) and artifacts.head(key_of(scene))
    ]


def objects(artifacts: Bucket) -> int:
    return sum(1 for _ in artifacts.list(prefix="overlays"))


def test_within_its_budget_nothing_is_deleted(world: World, artifacts: Bucket) -> None:
    mine(world, artifacts, "a", "b")
    budget = budget_of(world, artifacts, 18)
    budget.sweep(Event())
    assert (budget.used_bytes, budget.deleted, objects(artifacts)) == (180, 0, 18)


def test_withdrawn_scenes_go_first_and_then_the_lowest_scores(
    world: World, artifacts: Bucket
) -> None:
    mine(world, artifacts, "a", "b", "c")
    world.listed("a", "b")
    scores = [row.score for row in world.ledger.ranking()]
    budget_of(world, artifacts, 20).sweep(Event())
    assert objects(artifacts) == 20
    assert kept(world, artifacts) == scores
    budget = budget_of(world, artifacts, 5)
    budget.sweep(Event())
    assert objects(artifacts) == 5
    assert kept(world, artifacts) == scores[:5]
    assert budget.used_bytes == 50
    budget.sweep(Event())
    assert budget.deleted == 15


def test_selected_and_judged_scenes_keep_theirs_whatever_the_budget(
    world: World, artifacts: Bucket
) -> None:
    mine(world, artifacts, "a", "b")
    rows = world.ledger.ranking()
    world.ledger.selections.save("week", budget=1, scenes=[rows[-1]])
    judged = JudgeRequest(
        key="k1", reviewer="ada", scene_id=rows[-2].scene_id, verdict=Verdict("supervised")
    )
    world.ledger.verdicts.judge(judged)
    world.listed("a")
    budget = budget_of(world, artifacts, 1)
    budget.sweep(Event())
    assert objects(artifacts) == 2
    assert budget.used_bytes == 20
    world.listed("a", "b")
    assert sorted(kept(world, artifacts)) == sorted(row.score for row in rows[-2:])


def test_readers_say_so_and_retry_has_the_log_mined_again(world: World, artifacts: Bucket) -> None:
    mine(world, artifacts, "a", "b")
    before = [(scene.seq, scene.sha256) for scene in world.ledger.current_scenes()]
    budget_of(world, artifacts, 0).sweep(Event())
    row = next(row for row in world.ledger.ranking() if row.log_id == "a")
    scene = world.ledger.scene(row.scene_id)
    assert scene is not None
    for read in (read_overlay, open_stored_overlay):
        with pytest.raises(NothingFoundError, match=r"was deleted, by .* `counterpoint retry a`"):
            read(artifacts.url, scene)
    assert world.ledger.retry() == []
    retried = world.ledger.retry(["a"])
    assert [(work.log_id, work.attempts) for work in retried] == [("a", 0)] * 3
    world.clock.now_s += 60.0
    while isinstance(lease := world.claim(), MineLease):
        assert lease.rescore is None
        assert world.commit_shard(lease).ok
    assert [(scene.seq, scene.sha256) for scene in world.ledger.current_scenes()] == before
    assert world.ledger.retry(["b"])
    for stored in world.ledger.current_scenes():
        if stored.log_id == "a":
            artifacts.put(key_of(stored), b"x")
    world.ledger.retired_overlays.note()
    assert world.ledger.retry(["a"]) == []
    again = world.ledger.scene(row.scene_id)
    assert again is not None
    assert not again.overlay_deleted


def test_nothing_is_deleted_where_logs_lie(world: World, artifacts: Bucket) -> None:
    with pytest.raises(UsageError, match="artifacts_budget_bytes"):
        OverlayBudget(artifacts, world.ledger, budget_bytes=1, log_bucket_url=artifacts.url)
