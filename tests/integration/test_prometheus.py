"""A real Prometheus scrapes a real system: every panel finds data, and alerts fire for real.

What is provoked here fires from the metrics of the product itself; `test_prometheus_alerts.py`
plays the series of every alert, these too, to a real Prometheus of its own.
"""

import sqlite3
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Final

import pytest

from schemas.verdict import Verdict
from service.curation.verdicts import JudgeRequest
from service.store.engine import DATABASE_NAME
from tests.dashboard_reading import FOLDER, ReadPanel, read_dashboard, variables_of
from tests.factories import street_log
from tests.free_ports import free_port
from tests.integration.daemons import System
from tests.integration.prometheus_asking import AnswerError, query, query_range, rates
from tests.integration.prometheus_server import (
    PrometheusServer,
    need_prometheus,
    rules_at_once,
    until,
)
from workers.lab.simulation.faults.faults import PlantedFailure
from workers.lab.simulation.faults.plan import FailureKind

pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]

MINED_S: Final = 400.0
"""Until the system is there, and until its bucket is mined: machines that run tests are busy."""

WORKERS: Final = 2
"""Of the pool of a `System`."""

PANELS: Final = [
    (path, panel) for path in sorted(FOLDER.glob("*.json")) for panel in read_dashboard(path)
]

FAILURES: Final = tuple(
    PlantedFailure(kind, track, 0.0, 9.0)
    for kind, track in product(
        (FailureKind.MISSED_MOVER, FailureKind.PARKED_CALLED_MOVING), range(12)
    )
)


@dataclass
class Watched:
    """A system with what it mines, and the Prometheus that watches it."""

    system: System
    prometheus: PrometheusServer
    http: str
    bucket: Path
    state: Path
    began_s: float

    def value(self, expr: str) -> float:
        found = query(self.prometheus.address, expr, at_s=time.time())
        return sum(value for series in found for _, value in series.samples)

    def knows_every_counter(self) -> bool:
        """Whether both endpoints were scraped, with both workers there.

        What happens before the first scrape of a counter is in no rate and no increase of it.
        """
        return (
            self.value("count (counterpoint_worker_plan_seconds_count == 0)") == 1
            and self.value("count (counterpoint_worker_truncated_parts_total == 0)") == 1
            and self.value("sum (counterpoint_worker_connected)") == WORKERS
            and self.value('count (counterpoint_recordings{state="mining"} == 0)') == 1
        )

    def counted_by_workers(self) -> bool:
        """Whether the workers have counted, and been scraped, as often as the service stored."""
        stored = self.value('sum (counterpoint_commits_total{outcome="stored"})')
        plans = 'counterpoint_worker_plans_total{outcome=~"committed|refused"}'
        shards = 'counterpoint_worker_shards_total{outcome="committed"}'
        return self.value(f"sum ({plans})") + self.value(f"sum ({shards})") >= stored > 0


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watched]:
    need_prometheus()
    folder = tmp_path_factory.mktemp("watched")
    recorded = fill(folder / "recorded")
    bucket = folder / "bucket"
    bucket.mkdir()
    http, worker_http = (f"127.0.0.1:{free_port()}" for _ in range(2))
    settings = {
        "COUNTERPOINT_HTTP_LISTEN": http,
        "COUNTERPOINT_WORKER_HTTP_LISTEN": worker_http,
        "COUNTERPOINT_VEHICLES": "car-1,car-2",
        "COUNTERPOINT_LIST_INTERVAL_S": "0.5",
        "COUNTERPOINT_SETTLE_S": "1",
        "COUNTERPOINT_MAX_ATTEMPTS": "1",
        "COUNTERPOINT_ARTIFACTS_BUDGET_BYTES": "1000000000000",
    }
    options = ("--supervised", "recorded", "--shard-seconds", "2")
    system = System(folder, str(bucket), *options, env=settings)
    targets = {"counterpoint": [http], "counterpoint-worker": [worker_http]}
    began_s = time.time()
    with PrometheusServer(
        folder / "prometheus", targets=targets, rules=rules_at_once(folder)
    ) as prometheus:
        try:
            system.start()
            watched = Watched(system, prometheus, http, bucket, folder / "state", began_s)
            until(
                "a zero from which each counter rises",
                watched.knows_every_counter,
                deadline_s=MINED_S,
            )
            for vehicle in sorted(recorded.iterdir()):
                vehicle.rename(bucket / vehicle.name)
            yield watched
        finally:
            system.end()


def fill(bucket: Path) -> Path:
    """Write three drives of two cars, four that were cut off, one damaged, one that is no log."""
    for vehicle, seed in (("car-1", 1), ("car-1", 2), ("car-2", 3)):
        path = bucket / vehicle / "2026-03-02" / f"drive-{seed}.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        street_log(path, frames=40, seed=seed, vehicle=vehicle, failures=FAILURES)
    whole = (bucket / "car-1" / "2026-03-02" / "drive-1.mcap").read_bytes()
    other = bucket / "car-9" / "2026-03-02"
    other.mkdir(parents=True)
    for number in range(4):
        (other / f"cut-{number}.mcap").write_bytes(whole[: len(whole) // 3])
    (other / "text.mcap").write_bytes(b"this is no recording\n" * 100)
    damaged = street_log(other / "damaged.mcap", frames=40, vehicle="car-9", chunk_bytes=20_000)
    scratched = bytearray(damaged.read_bytes())
    for place in range(len(scratched) // 8, len(scratched) * 7 // 8, 15_000):
        scratched[place : place + 64] = bytes(64)
    damaged.write_bytes(scratched)
    return bucket


@pytest.fixture(scope="module")
def mined(watched: Watched) -> Watched:
    """Wait until everything that can be mined is, and has been scraped."""
    waiting = 'sum (counterpoint_recordings{state=~"waiting|settling|planning|mining"})'
    until(
        "everything is mined",
        lambda: (
            watched.value("sum (counterpoint_scenes_total)") >= 9
            and watched.value(waiting) == 0
            and watched.counted_by_workers()
        ),
        deadline_s=MINED_S,
    )
    best = watched.system.client.top(1)[0]
    watched.system.client.judge(
        JudgeRequest(key="w", scene_id=best.scene_id, reviewer="ann", verdict=Verdict.SUPERVISED)
    )
    until(
        "its verdict has been scraped",
        lambda: watched.value("sum (counterpoint_judged_scenes)") == 1,
        deadline_s=MINED_S,
    )
    return watched


OF_TWO_SERVICES = ("counterpoint_service_standbys",)
"""Metrics of a service that has a standby, which `test_standby.py` runs."""


@pytest.mark.parametrize(
    ("path", "panel"), PANELS, ids=[f"{path.stem}: {panel.title}" for path, panel in PANELS]
)
def test_every_query_of_every_panel_finds_data(
    mined: Watched, path: Path, panel: ReadPanel
) -> None:
    end_s = time.time()
    variables = variables_of(
        path, rate_interval="10s", time_range=f"{round(end_s - mined.began_s)}s"
    )
    for target in panel.targets:
        text = target.filled(variables)
        if target.kind == "path":
            rows = rates(mined.http, text)
            assert rows, text
            assert all({"group", *target.values} <= row.keys() for row in rows)
        elif panel.kind == "stat":
            assert any(s.samples for s in query(mined.prometheus.address, text, at_s=end_s)), text
        else:
            # A second ahead: the last scrape lies behind the last whole second.
            found = query_range(
                mined.prometheus.address, text, start_s=mined.began_s, end_s=end_s + 1, step_s=1
            )
            has_data = any(series.samples for series in found)
            assert has_data != any(name in text for name in OF_TWO_SERVICES), text


@pytest.mark.parametrize(("damage", "logs"), [("truncated", 4), ("unreadable", 1)])
def test_logs_that_are_mined_only_in_part_are_counted_as_logs(
    mined: Watched, damage: str, logs: int
) -> None:
    expr = f'counterpoint_damaged_recordings{{damage="{damage}"}}'
    until("it is scraped", lambda: mined.value(expr) == logs)


def test_no_rule_fails_on_the_real_series(mined: Watched) -> None:
    assert mined.prometheus.rules_with_errors() == []


def test_a_wrong_expression_is_not_taken_for_one_without_data(mined: Watched) -> None:
    with pytest.raises(AnswerError, match="400"):
        query(mined.prometheus.address, "sum (", at_s=time.time())


@pytest.mark.parametrize(
    "alert",
    ["CounterpointLogsRefused", "CounterpointTruncatedLogs", "CounterpointDamagedChunks"],
)
def test_what_is_wrong_with_logs_is_told(mined: Watched, alert: str) -> None:
    mined.prometheus.until_firing(alert)


def test_a_healthy_system_is_not_said_to_be_down(mined: Watched) -> None:
    down = {
        "CounterpointDown",
        "CounterpointWorkerDown",
        "CounterpointDatabaseSilent",
        "CounterpointDatabaseErrors",
        "CounterpointBucketErrors",
        "CounterpointBucketNotListed",
        "CounterpointWorkersMissing",
        "CounterpointWorkParked",
    }
    # No rule waits here, so that one scrape too slow is told for the second that it lasts.
    until("it is said to be well", lambda: not mined.prometheus.firing().keys() & down)


def test_a_bucket_that_is_gone_is_told(mined: Watched) -> None:
    away = mined.bucket.rename(mined.bucket.with_name("away"))
    try:
        mined.prometheus.until_firing("CounterpointBucketErrors")
    finally:
        away.rename(mined.bucket)


def test_a_database_that_is_held_by_another_is_told(mined: Watched) -> None:
    with sqlite3.connect(mined.state / DATABASE_NAME, isolation_level=None) as held:
        held.execute("BEGIN IMMEDIATE")
        try:
            mined.prometheus.until_firing("CounterpointDatabaseErrors")
        finally:
            held.execute("ROLLBACK")
    held.close()


def test_workers_without_a_router_are_told(mined: Watched) -> None:
    mined.system.router.kill()
    try:
        mined.prometheus.until_firing("CounterpointWorkersDisconnected")
    finally:
        mined.system.router.start()
    until(
        "the workers are back",
        lambda: "CounterpointWorkersDisconnected" not in mined.prometheus.firing(),
    )


def test_workers_that_die_over_a_shard_are_told_and_so_is_the_shard_that_is_parked(
    mined: Watched,
) -> None:
    street_log(mined.bucket / "car-2" / "2026-03-02" / "late.mcap", frames=400, vehicle="car-2")
    until("a shard is mined", lambda: shards_leased(mined) > 0)  # not the plan: it ends at once
    mined.system.pool.kill()
    mined.prometheus.until_firing("CounterpointWorkerDown")
    until("the leases of the dead end", lambda: shards_leased(mined) == 0)
    mined.system.pool.start()  # where all workers die, the second death parks, of one attempt
    until("a shard is mined again", lambda: shards_leased(mined) > 0)
    mined.system.pool.kill()
    mined.prometheus.until_firing("CounterpointWorkParked")


def test_a_service_that_is_gone_is_told(mined: Watched) -> None:
    mined.system.service.kill()
    mined.prometheus.until_firing("CounterpointDown")


def shards_leased(watched: Watched) -> int:
    status = watched.system.status()
    return 0 if status is None else status.shards_by_state.get("leased", 0)
