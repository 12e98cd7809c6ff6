"""What is deleted of the artifacts, and what never is."""

from collections.abc import Iterator
from pathlib import Path
from threading import Event

import pytest
import structlog.testing

from schemas.errors import BucketUnreachableError
from schemas.overlay import overlay_key
from schemas.transport.bucket import Bucket, open_bucket
from service.background.overlay_cleanup import DAY_S, OverlaySweep
from service.errors import UsageError
from service.store.engine import open_store
from tests.contracts.ledger_world import World

KEEP_DAYS = 7
LOGS = "file:///somewhere/logs"


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    (tmp_path / "state").mkdir()
    store = open_store(tmp_path / "state")
    yield World.on(store)
    store.close()


@pytest.fixture
def artifacts(tmp_path: Path) -> Bucket:
    return open_bucket(str(tmp_path / "artifacts"), create=True)


def sweep_of(world: World, artifacts: Bucket) -> OverlaySweep:
    return OverlaySweep(artifacts, world.ledger, keep_s=KEEP_DAYS * DAY_S, log_bucket_url=LOGS)


def mine(world: World, artifacts: Bucket, *log_ids: str) -> None:
    """Mine these logs, and write the overlay of every scene as workers do."""
    world.listed(*log_ids)
    world.mine_all()
    for scene in world.ledger.current_scenes():
        key = overlay_key(
            log_id=scene.log_id,
            scene_id=scene.scene_id,
            pipeline_version=scene.pipeline_version,
            sha256=scene.sha256,
        )
        artifacts.put(key, b"points")


def logs_with_overlays(artifacts: Bucket) -> list[str]:
    keys = [found.key for found in artifacts.list() if found.key.endswith(".overlay")]
    return sorted({key.split("/")[2] for key in keys})


def test_overlays_of_scenes_withdrawn_long_ago_go_and_all_else_stays(
    world: World, artifacts: Bucket
) -> None:
    mine(world, artifacts, "a", "b", "c")
    for strange in ("counterpoint-probe", "overlays/p1/a/notes.txt", "a.mcap"):
        artifacts.put(strange, b"not ours to delete")
    before = {found.key for found in artifacts.list()}
    sweep = sweep_of(world, artifacts)
    sweep.sweep(Event())
    world.listed("c")
    sweep.sweep(Event())
    world.clock.now_s += KEEP_DAYS * DAY_S - 1
    sweep.sweep(Event())
    assert {found.key for found in artifacts.list()} == before
    world.clock.now_s += 1
    with structlog.testing.capture_logs() as said:
        sweep.sweep(Event())
        sweep.sweep(Event())
    gone = before - {found.key for found in artifacts.list()}
    assert len(gone) == sweep.deleted == 18
    assert all(key.startswith(("overlays/p1/a/@/", "overlays/p1/b/@/")) for key in gone)
    assert [(each["overlays"], each["keep_withdrawn_days"]) for each in said] == [(18, KEEP_DAYS)]
    assert logs_with_overlays(artifacts) == ["c"]
    assert world.ledger.last_seq() == 27 + 18, "what is known of scenes stays as it was"


def test_a_sweep_that_was_killed_goes_on_and_minds_nothing_that_is_gone_already(
    world: World, artifacts: Bucket, tmp_path: Path
) -> None:
    mine(world, artifacts, "a", "b")
    world.listed("b")
    world.ledger.retired_overlays.note()
    world.clock.now_s += KEEP_DAYS * DAY_S
    for found in list(artifacts.list())[:5]:
        artifacts.delete(found.key)
    sweep_of(world, artifacts).sweep(Event())
    assert logs_with_overlays(artifacts) == ["b"]
    assert not (tmp_path / "artifacts" / "overlays" / "p1" / "a").exists()
    assert world.ledger.retired_overlays.to_delete(keep_s=0, limit=10) == []


def test_artifacts_that_are_away_are_swept_when_they_are_back(
    world: World, artifacts: Bucket, tmp_path: Path
) -> None:
    mine(world, artifacts, "a", "b")
    world.listed("b")
    sweep = sweep_of(world, artifacts)
    sweep.sweep(Event())
    world.clock.now_s += KEEP_DAYS * DAY_S
    away = (tmp_path / "artifacts").rename(tmp_path / "away")
    with pytest.raises(BucketUnreachableError, match="the folder is gone"):
        sweep.sweep(Event())
    away.rename(tmp_path / "artifacts")
    assert logs_with_overlays(artifacts) == ["a", "b"]
    sweep.sweep(Event())
    assert logs_with_overlays(artifacts) == ["b"]
    assert sweep.deleted == 9


def test_told_to_stop_it_deletes_no_more(world: World, artifacts: Bucket) -> None:
    mine(world, artifacts, "a", "b")
    world.listed("b")
    sweep, stop = sweep_of(world, artifacts), Event()
    sweep.sweep(stop)
    world.clock.now_s += KEEP_DAYS * DAY_S
    stop.set()
    sweep.sweep(stop)
    assert logs_with_overlays(artifacts) == ["a", "b"]


@pytest.mark.parametrize(
    ("artifacts_at", "logs_at"),
    [("fleet", "fleet"), ("fleet/state/artifacts", "fleet"), ("fleet", "fleet/logs")],
)
def test_nothing_is_deleted_where_logs_lie(
    world: World, tmp_path: Path, artifacts_at: str, logs_at: str
) -> None:
    artifacts = open_bucket(str(tmp_path / artifacts_at), create=True)
    logs = open_bucket(str(tmp_path / logs_at), create=True)
    with pytest.raises(UsageError, match="nothing may be deleted where logs lie"):
        OverlaySweep(artifacts, world.ledger, keep_s=DAY_S, log_bucket_url=logs.url)


def test_a_place_whose_name_only_begins_alike_is_another(world: World, tmp_path: Path) -> None:
    artifacts = open_bucket(str(tmp_path / "fleet-overlays"), create=True)
    logs = open_bucket(str(tmp_path / "fleet"), create=True)
    sweep = OverlaySweep(artifacts, world.ledger, keep_s=DAY_S, log_bucket_url=logs.url)
    assert sweep.interval_s == 3600
