"""What workers count: every series there from the start, labels closed, sums that outlive them."""

import multiprocessing
import shutil
from pathlib import Path

import pytest
from prometheus_client import CollectorRegistry
from structlog.testing import capture_logs

from schemas.errors import TransientError
from schemas.frame import OdometryState
from schemas.labels import Blindness
from schemas.score import StreamHealth
from schemas.work import Damage, LogPlan, MiningStats
from tests.factories import scene_score
from workers.pool.metrics_folder import MetricsFolder
from workers.pool.shared_metrics import FILE_BYTES, SharedMetrics, count_in
from workers.worker.metrics import PoolMetrics, WorkerMetrics

MOST_SERIES = 300


def value(registry: CollectorRegistry, name: str, **labels: str) -> float | None:
    return registry.get_sample_value(f"counterpoint_worker_{name}", labels)


def stream_health(*, seen_share: float, pose_jumps: int) -> StreamHealth:
    return StreamHealth(
        unknown_share=0.3, seen_share=seen_share, blind_share=0.1, pose_jumps=pose_jumps
    )


def test_every_series_is_there_before_anything_happened() -> None:
    metrics = WorkerMetrics()
    PoolMetrics(metrics.registry)
    families = list(metrics.registry.collect())
    samples = [sample for family in families for sample in family.samples]
    assert all(family.name.startswith("counterpoint_worker_") for family in families)
    assert all(family.samples for family in families), "a rate needs a zero to rise from"
    assert all(sample.value == 0 for sample in samples if not sample.name.endswith("_created"))
    assert len(samples) < MOST_SERIES


def test_every_help_is_a_sentence() -> None:
    metrics = WorkerMetrics()
    PoolMetrics(metrics.registry)
    for family in metrics.registry.collect():
        assert family.documentation.endswith("."), family.name


def test_a_shard_is_counted_by_what_it_took_and_found() -> None:
    metrics = WorkerMetrics()
    stats = MiningStats(
        frames=20, bytes_read=110, bytes_needed=100, range_reads=3, peak_memory_bytes=7
    )
    health = {OdometryState.HEALTHY: 18, OdometryState.LOST: 2}
    torn = Damage(offset=4, bytes=8, what="CRC differs")
    noticed = Damage(offset=0, bytes=0, what="answers without a class")
    metrics.mined(
        stats,
        scenes=1,
        damage=[torn] * 4 + [noticed],
        odometry_frames=health,
        blind_frames={Blindness.NO_FIT: 3},
        motion_points={"static": 70, "unknown": 30},
    )
    metrics.scene_mined(scene_score(health=stream_health(seen_share=0.97, pose_jumps=1)))
    metrics.shard_committed({"supervised": 3.0, "committing": 0.01}, seconds=9.0)
    metrics.shard_ended("committed")
    registry = metrics.registry
    assert value(registry, "frames_total") == 20
    assert value(registry, "scenes_total") == 1
    assert value(registry, "damaged_chunks_total") == 4
    assert value(registry, "bytes_read_total", work="mine") == 110
    assert value(registry, "bytes_read_total", work="plan") == 0
    assert value(registry, "bytes_needed_total") == 100
    assert value(registry, "odometry_frames_total", state="lost") == 2
    assert value(registry, "odometry_frames_total", state="degraded") == 0
    assert value(registry, "blind_frames_total", cause="no_fit") == 3
    assert value(registry, "blind_frames_total", cause="no_past") == 0
    assert value(registry, "motion_points_total", label="unknown") == 30
    assert value(registry, "pose_jumps_total") == 1
    assert value(registry, "static_residual_m_bucket", le="0.06") == 1
    assert value(registry, "seen_share_bucket", le="0.95") == 0
    assert value(registry, "seen_share_count") == 1
    assert value(registry, "stage_seconds_sum", stage="supervised") == 3.0
    assert value(registry, "shard_seconds_bucket", le="10.0") == 1
    assert value(registry, "shards_total", outcome="committed") == 1
    assert value(registry, "peak_memory_bytes") == 7


def _work(folder: Path, place: int) -> None:
    """What a worker process does: at work on a shard when it dies, after one that it finished."""
    count_in(folder, place)
    metrics = WorkerMetrics()
    metrics.planned(LogPlan(log_id="a", range_reads=5), truncated_parts=1)
    metrics.shard_committed({"odometry": 2.0}, seconds=4.0)
    metrics.shard_ended("committed")
    metrics.router_seen(True)
    metrics.lease_began()


def work_in_a_process(folder: Path, place: int) -> None:
    process = multiprocessing.get_context("fork").Process(target=_work, args=(folder, place))
    process.start()
    process.join()
    assert process.exitcode == 0


def places(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.suffix == ".db")


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_counts_go_on_over_restarts_gauges_of_the_dead_vanish_and_files_stay_few(
    tmp_path: Path,
) -> None:
    shared = SharedMetrics(tmp_path, places=2)
    files = places(shared.folder)
    work_in_a_process(shared.folder, 0)
    work_in_a_process(shared.folder, 1)
    assert value(shared.registry, "shards_total", outcome="committed") == 2
    assert value(shared.registry, "busy") == 2
    shared.forget_gauges(0)
    assert value(shared.registry, "busy") == 1
    assert value(shared.registry, "connected") == 1
    for _ in range(3):
        work_in_a_process(shared.folder, 0)
        shared.forget_gauges(0)
    work_in_a_process(shared.folder, 0)
    assert value(shared.registry, "shards_total", outcome="committed") == 6
    assert value(shared.registry, "stage_seconds_count", stage="odometry") == 6
    assert value(shared.registry, "range_reads_total", work="plan") == 30
    assert value(shared.registry, "busy") == 2
    assert places(shared.folder) == files
    sizes = {path.stat().st_size for path in shared.folder.glob("*.db")}
    assert sizes == {FILE_BYTES}, "none outgrew it"
    shared.remove()
    assert not list(tmp_path.iterdir())


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_every_kind_of_file_that_the_metrics_need_was_given_its_room(tmp_path: Path) -> None:
    shared, needed = SharedMetrics(tmp_path, places=1), tmp_path / "needed"
    needed.mkdir()
    work_in_a_process(needed, 0)
    assert places(needed) == places(shared.folder)


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_files_that_somebody_took_away_are_made_again_and_it_is_said_once(tmp_path: Path) -> None:
    shared = SharedMetrics(tmp_path, places=2)
    files = places(shared.folder)
    with capture_logs() as said:
        shared.mend()
        assert not said
        next(shared.folder.glob("gauge*_0.db")).unlink()
        shared.forget_gauges(0)
        shutil.rmtree(shared.folder)
        shared.forget_gauges(1)
        shared.mend()
    assert [each["files"] for each in said] == [1, len(files)]
    assert places(shared.folder) == files
    work_in_a_process(shared.folder, 1)
    assert value(shared.registry, "shards_total", outcome="committed") == 1


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_where_nothing_can_be_kept_it_is_said_once_and_workers_count_for_themselves(
    tmp_path: Path,
) -> None:
    shared = SharedMetrics(tmp_path, places=1)
    shutil.rmtree(shared.folder)
    shared.folder.write_text("in the way")
    with capture_logs() as said:
        for _ in range(3):
            shared.mend()
            shared.forget_gauges(0)
    assert [each["event"] for each in said] == [
        "metrics of the workers cannot be kept; mining goes on without them"
    ]
    work_in_a_process(shared.folder / "nowhere", 0)
    shared.folder.unlink()
    with capture_logs() as said:
        shared.mend()
    assert "made again" in said[0]["event"]


def test_a_place_that_cannot_be_is_refused_with_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "home").write_text("a file")
    with pytest.raises(TransientError, match="NUMBA_CACHE_DIR") as refused:
        SharedMetrics(tmp_path / "home", places=1)
    assert str(tmp_path / "home") in str(refused.value)


def test_what_a_killed_pool_left_is_taken_away_and_what_a_living_one_holds_is_not(
    tmp_path: Path,
) -> None:
    living, killed = MetricsFolder(tmp_path), MetricsFolder(tmp_path)
    assert living.hold()
    assert killed.hold()
    (killed.path / "counter_0.db").write_bytes(b"left")
    killed._let_go()  # as the kernel does at a kill
    another = MetricsFolder(tmp_path)
    assert another.hold()
    assert not another.hold(), "it is there"
    assert sorted(tmp_path.iterdir()) == sorted([living.path, another.path])
    living.remove()
    another.remove()
    assert not list(tmp_path.iterdir())
