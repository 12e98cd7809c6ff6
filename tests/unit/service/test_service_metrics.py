import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families

from schemas.contradiction import ContradictionKind, SceneState
from schemas.score import KindTotal
from service.background.bucket_watch import BucketSeen
from service.errors import StatementFailedError, StateUnusableError
from service.monitoring import gauges
from service.monitoring.gauges import Sources
from service.monitoring.metrics import MOST_VEHICLES, ServiceMetrics
from service.store.backlog import Backlog
from service.store.engine import open_store
from service.store.faults import StoreUnavailableError
from service.store.transaction_effects import Effects
from tests.contracts.ledger_world import START_NS, World, plan_of, score_of

COMPARED = {"both_static", "both_dynamic", "only_semantic_dynamic", "only_predictive_dynamic"}


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    store = open_store(tmp_path)
    yield World.on(store)
    store.close()


def value(metrics: ServiceMetrics, name: str, **labels: str) -> float | None:
    return metrics.registry.get_sample_value(f"counterpoint_{name}", labels)


def test_frames_scenes_and_points_count_once_however_often_a_commit_comes(world: World) -> None:
    metrics = ServiceMetrics()
    world.ledger.observe(metrics)
    world.listed("a")
    assert world.commit_plan(world.plan_lease(), plan=plan_of("a", shards=1)).ok
    lease = world.mine_lease()
    for _ in range(3):
        assert world.commit_shard(lease).ok
    assert value(metrics, "scenes_total", state="scored") == 3
    assert value(metrics, "frames_total") == 60
    assert value(metrics, "points_total", agreement="only_semantic_dynamic") == 3 * 40
    assert value(metrics, "points_total", agreement="not_compared") == 3 * 200
    assert value(metrics, "scene_score_count") == 3
    assert value(metrics, "commits_total", work="shard", outcome="stored") == 1
    assert value(metrics, "commits_total", work="shard", outcome="repeated") == 2
    assert value(metrics, "leases_ended_total", reason="committed") == 2


def test_the_counted_points_agree_with_the_status(world: World) -> None:
    metrics = ServiceMetrics()
    world.ledger.observe(metrics)
    world.listed("a", "b")
    world.mine_all()
    points = world.ledger.status().points.model_dump()
    assert set(points) == COMPARED | {"not_compared"}
    for agreement, count in points.items():
        assert value(metrics, "points_total", agreement=agreement) == count > -1


def test_contradictions_count_by_kind() -> None:
    metrics = ServiceMetrics()
    total = KindTotal(
        kind=ContradictionKind.ONLY_PREDICTIVE_DYNAMIC, instances=12, tracks=2, points=300
    )
    score = score_of("a", START_NS).model_copy(update={"totals": (total,)})
    metrics.on_effects(Effects(scenes=[score]))
    kind = "only_predictive_dynamic"
    assert value(metrics, "contradicting_tracks_total", kind=kind) == 2
    assert value(metrics, "contradicting_instances_total", kind=kind) == 12
    assert value(metrics, "contradicting_tracks_total", kind="only_semantic_dynamic") == 0


def test_only_vehicles_that_were_named_have_series_of_their_own() -> None:
    metrics = ServiceMetrics(vehicles=["car-1"])
    for vehicle in ("car-1", "car-2", "unknown", "other"):
        score = score_of("a", START_NS).model_copy(update={"vehicle": vehicle})
        metrics.on_effects(Effects(scenes=[score]))
    assert value(metrics, "vehicle_scenes_total", vehicle="car-1") == 1
    assert value(metrics, "vehicle_scenes_total", vehicle="other") == 3
    assert value(metrics, "vehicle_scenes_total", vehicle="car-2") is None


def test_the_number_of_vehicles_has_a_cap() -> None:
    metrics = ServiceMetrics(vehicles=[f"car-{index:02}" for index in range(60)])
    series = [
        sample
        for family in metrics.registry.collect()
        for sample in family.samples
        if sample.name == "counterpoint_vehicle_scenes_total"
    ]
    assert len(series) == MOST_VEHICLES + 1


def test_every_series_is_there_before_anything_happens() -> None:
    """A rate needs a zero to rise from."""
    metrics = ServiceMetrics()
    metrics.read_from(Sources())
    assert value(metrics, "scenes_total", state=SceneState.ODOMETRY_LOST.value) == 0
    assert value(metrics, "questions_total", verb="rates", outcome="refused") == 0
    assert value(metrics, "leases_ended_total", reason="worker_died") == 0
    assert value(metrics, "work", work="shard", state="parked") == 0
    assert value(metrics, "bucket_errors_total", kind="refused") == 0


def test_a_reason_of_two_words_is_one_label() -> None:
    metrics = ServiceMetrics()
    effects = Effects()
    effects.leases_ended["worker died"] += 2
    metrics.on_effects(effects)
    assert value(metrics, "leases_ended_total", reason="worker_died") == 2


def test_gauges_say_how_things_stand() -> None:
    metrics = ServiceMetrics()
    metrics.read_from(
        Sources(
            backlog=lambda: Backlog(work={("shard", "ready"): 7}, oldest_listed_s=900.0),
            bucket_url="s3://fleet",
            bucket=lambda: BucketSeen(last_success_s=950.0, objects=3, bytes=300),
            bus_misses=lambda: 4,
            state_free_bytes=lambda: 10**9,
            now_s=lambda: 1000.0,
        )
    )
    assert value(metrics, "work", work="shard", state="ready") == 7
    assert value(metrics, "oldest_work_age_seconds") == 100
    seen = value(metrics, "bucket_last_listing_timestamp_seconds", bucket="s3://fleet")
    assert seen == 950
    assert value(metrics, "bus_misses_total") == 4
    assert value(metrics, "state_free_bytes") == 10**9


def test_a_database_that_does_not_answer_takes_only_its_own_series_away() -> None:
    def away() -> Backlog:
        raise StoreUnavailableError("database is locked")

    metrics = ServiceMetrics()
    metrics.read_from(Sources(backlog=away, staging_bytes=lambda: 5))
    assert value(metrics, "work", work="shard", state="ready") is None
    assert value(metrics, "staging_bytes") == 5
    assert value(metrics, "frames_total") == 0


def test_the_ledger_is_counted_once_for_many_scrapes(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def count() -> Backlog:
        asked.append(1)
        return Backlog()

    metrics = ServiceMetrics()
    metrics.read_from(Sources(backlog=count))
    assert not asked
    for _ in range(3):
        generate_latest(metrics.registry)
    assert len(asked) == 1
    monkeypatch.setattr(gauges, "CACHED_S", 0.0)
    generate_latest(metrics.registry)
    assert len(asked) == 2


def test_a_failed_transaction_counts_as_a_database_error(world: World) -> None:
    metrics = ServiceMetrics()
    world.ledger.observe(metrics)
    with pytest.raises(StatementFailedError), world.store.writing() as connection:
        connection.exec_driver_sql("SELECT FROM WHERE")
    assert value(metrics, "database_errors_total") == 0, "the database is not to blame"
    with world.store.writing() as connection:
        connection.exec_driver_sql("DROP TABLE leases")
    with pytest.raises(StateUnusableError, match="its tables are gone"):
        world.ledger.expire()
    assert value(metrics, "database_errors_total") == 1


def test_every_metric_says_when_to_worry_or_is_plain_information() -> None:
    metrics = ServiceMetrics()
    metrics.read_from(Sources())
    silent = {
        family.name
        for family in metrics.registry.collect()
        if "worry" not in family.documentation.lower()
    }
    assert silent == {
        "counterpoint_build_info",
        "counterpoint_current_scenes",
        "counterpoint_leases_held",
    }


def test_the_page_can_be_parsed_and_is_clean(tmp_path: Path) -> None:
    metrics = ServiceMetrics(vehicles=["car-1"])
    metrics.read_from(Sources())
    page = generate_latest(metrics.registry)
    assert len(list(text_string_to_metric_families(page.decode()))) > 25
    try:
        checked = subprocess.run(
            ["promtool", "check", "metrics"], input=page, capture_output=True, timeout=30
        )
    except FileNotFoundError:
        pytest.skip("needs promtool, of Debian's package `prometheus`")
    assert (checked.returncode, checked.stdout + checked.stderr) == (0, b"")
