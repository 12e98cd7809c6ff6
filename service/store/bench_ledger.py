"""Benchmark of the ledger: durable shards per second, and the limits of disk and SQLite alone."""

import os
import sqlite3
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import NS_PER_S
from schemas.canonical import sha256
from schemas.contradiction import SceneState
from schemas.frame import OdometryState
from schemas.score import AgreementShares, OdometryHealth, Producers, Reason, SceneScore
from schemas.transport.wire import encode_scene_score
from schemas.work import (
    Channel,
    ClaimRequest,
    CommitRequest,
    LogPlan,
    ManifestEntry,
    MineLease,
    MiningStats,
    Part,
    PlanLease,
    Recording,
    Shard,
)
from service.store.engine import open_store
from service.store.ledger import LeasePolicy, Ledger

THREADS: Final = (1, 4, 16)
"""Concurrent requests: of one worker, of as many as the service has cores, of a large pool."""

SHARDS_PER_LOG: Final = 100
_VERSION: Final = "bench"
_SCENE_NS: Final = 2 * NS_PER_S
_START_NS: Final = 1_700_000_000 * NS_PER_S
_WORKER: Final = "bench-0"


class LedgerTiming(BaseModel):
    """Throughput and latency of one kind of write.

    Attributes:
        what: Kind of write; `fdatasync` and `bare SQLite` are the lower bounds.
        threads: Concurrent writers.
        scenes: Scenes in the ledger at the start.
        per_s: Durable writes per second.
        median_ms: Median latency of one writer, milliseconds.
        p99_ms: 99th percentile of that latency, milliseconds.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    what: str
    threads: int = Field(ge=1)
    scenes: int = Field(ge=0)
    per_s: float
    median_ms: float
    p99_ms: float


def bench_ledger(
    folder: Path,
    *,
    scenes_per_shard: int,
    shards: int,
    filled: int,
    on_progress: Callable[[str], None] = lambda _: None,
) -> list[LedgerTiming]:
    """Time claims and commits on an empty ledger, and on one with many scenes.

    Args:
        folder: On the disk under test; a database is made in it.
        scenes_per_shard: Records in one commit.
        shards: Claimed and committed for one row.
        filled: Scenes in the ledger for the second half of the rows; 0: no second half.
        on_progress: Called with the name of each measurement.
    """
    store = open_store(folder)
    try:
        bench = _Bench(
            Ledger(
                store,
                now_s=lambda: time.clock_gettime(time.CLOCK_REALTIME),
                policy=LeasePolicy(lease_s=3600.0, plan_ahead=1 << 40),
            ),
            scenes_per_shard=scenes_per_shard,
        )
        on_progress("the disk")
        rows = [_fdatasync(folder / "fdatasync", times=shards)]
        rows.append(_bare_sqlite(folder / "bare.sqlite", times=shards))
        for scenes in (0, filled) if filled else (0,):
            on_progress(f"a ledger of {scenes} scenes")
            bench.fill(scenes)
            for threads in THREADS:
                rows += bench.time_apart(shards, threads=threads)
                rows.append(bench.time_cycles(shards, threads=threads))
        return rows
    finally:
        store.close()


class _Bench:
    """A ledger, and simulated workers that only exchange messages."""

    def __init__(self, ledger: Ledger, *, scenes_per_shard: int) -> None:
        self._ledger, self._scenes_per_shard = ledger, scenes_per_shard
        self._recordings: list[Recording] = []
        self._records: dict[str, tuple[bytes, ...]] = {}
        self._stored = 0

    def fill(self, scenes: int) -> None:
        """Commit until the ledger has this many scenes."""
        while self._stored < scenes:
            self.time_cycles(min(4000, (scenes - self._stored) // self._scenes_per_shard + 1), 16)

    def time_apart(self, shards: int, *, threads: int) -> list[LedgerTiming]:
        """Claim all shards, then commit them."""
        self._supply(shards)
        leases: list[MineLease] = []
        claims = self._timed(
            "claim", [lambda: leases.append(self._claim())] * shards, threads=threads
        )
        requests = [self._request(lease) for lease in leases]
        before = self._stored
        commits = self._timed(
            "commit",
            [lambda r=request: self._commit(*r) for request in requests],  # type: ignore[misc]
            threads=threads,
        )
        self._stored = before + shards * self._scenes_per_shard
        return [claims, commits]

    def time_cycles(self, shards: int, threads: int) -> LedgerTiming:
        """Claim a shard, commit it, and repeat, as a worker does."""
        self._supply(shards)
        timing = self._timed(
            "claim and commit",
            [lambda: self._commit(*self._request(self._claim()))] * shards,
            threads=threads,
        )
        self._stored += shards * self._scenes_per_shard
        return timing

    def _timed(
        self, what: str, calls: Sequence[Callable[[], object]], *, threads: int
    ) -> LedgerTiming:
        def one(call: Callable[[], object]) -> float:
            begun_s = time.perf_counter()
            call()
            return time.perf_counter() - begun_s

        with ThreadPoolExecutor(threads) as pool:
            begun_s = time.perf_counter()
            durations_s = list(pool.map(one, calls))
            return _timing(
                what,
                durations_s,
                wall_s=time.perf_counter() - begun_s,
                threads=threads,
                scenes=self._stored,
            )

    def _supply(self, shards: int) -> None:
        """Plan enough logs, and make the records of their shards."""
        first = len(self._recordings)
        for number in range(first, first - (-shards // SHARDS_PER_LOG)):
            log_id = f"car-{number % 10}/{number:05d}"
            part = Part(key=f"{log_id}.mcap", size=1, etag=log_id)
            self._recordings.append(Recording(log_id=log_id, parts=(part,)))
        self._ledger.sync_recordings(self._recordings)
        self._records.clear()
        for _ in self._recordings[first:]:
            grant = self._ledger.claim(_CLAIM).grant
            if not isinstance(grant, PlanLease):
                raise TypeError(f"expected a plan to be made, got {grant.kind}")
            plan = made_up_plan(
                grant.recording.log_id,
                shards=min(SHARDS_PER_LOG, shards),
                scenes_per_shard=self._scenes_per_shard,
            )
            shards -= len(plan.shards)
            request = CommitRequest(worker_id=_WORKER, lease_id=grant.lease_id, plan=plan)
            self._commit(request, {})
            for shard in plan.shards:
                records = tuple(record for _, record in made_up_records(shard))
                self._records[f"{shard.log_id}/{shard.name}"] = records

    def _claim(self) -> MineLease:
        grant = self._ledger.claim(_CLAIM).grant
        if not isinstance(grant, MineLease):
            raise TypeError(f"expected a shard to mine, got {grant.kind}")
        return grant

    def _request(self, lease: MineLease) -> tuple[CommitRequest, dict[str, bytes]]:
        shard = lease.shard
        records = self._records[f"{shard.log_id}/{shard.name}"]
        staged = {sha256(record): record for record in records}
        starts_ns = range(shard.start_ns, shard.end_ns, _SCENE_NS)
        return (
            CommitRequest(
                worker_id=_WORKER,
                lease_id=lease.lease_id,
                manifest=tuple(
                    ManifestEntry(
                        scene_id=f"{shard.log_id}/{shard.lidar_name}/{start_ns}", sha256=digest
                    )
                    for start_ns, digest in zip(starts_ns, staged, strict=True)
                ),
                stats=MiningStats(frames=200, points=10_000_000, stage_s={"ingest": 1.0}),
            ),
            staged,
        )

    def _commit(self, request: CommitRequest, staged: dict[str, bytes]) -> None:
        answer = self._ledger.commit(request, staged)
        if not answer.ok:
            raise RuntimeError(f"the ledger refused a commit: {answer.problem or answer.missing}")


def made_up_plan(log_id: str, *, shards: int, scenes_per_shard: int) -> LogPlan:
    """Return a plan of so many shards, which read nothing."""
    length_ns = scenes_per_shard * _SCENE_NS
    starts_ns = [_START_NS + index * length_ns for index in range(shards)]
    return LogPlan(
        log_id=log_id,
        vehicle=log_id.partition("/")[0],
        lidar_topics=(LIDAR.topic,),
        shards=tuple(
            Shard(
                log_id=log_id,
                index=index,
                lidar=LIDAR,
                anchor_ns=_START_NS,
                warmup_start_ns=start_ns,
                start_ns=start_ns,
                end_ns=start_ns + length_ns,
                lookahead_end_ns=start_ns + length_ns,
                first_of_log=index == 0,
                last_of_log=index == shards - 1,
                chunks=(),
                needed_bytes=1,
            )
            for index, start_ns in enumerate(starts_ns)
        ),
    )


def made_up_records(shard: Shard) -> Iterator[tuple[str, bytes]]:
    """Yield id and record of every scene of a shard, the same whenever it is mined."""
    for start_ns in range(shard.start_ns, shard.end_ns, _SCENE_NS):
        scene_id = f"{shard.log_id}/{shard.lidar_name}/{start_ns}"
        score = SCORE.model_copy(
            update={
                "scene_id": scene_id,
                "log_id": shard.log_id,
                "start_ns": start_ns,
                "end_ns": start_ns + _SCENE_NS - NS_PER_S // 10,
            }
        )
        yield scene_id, encode_scene_score(score)


def _fdatasync(path: Path, *, times: int) -> LedgerTiming:
    """Append a page and wait for the disk, the lower bound of a durable commit."""
    durations_s = []
    file = os.open(path, os.O_WRONLY | os.O_CREAT, 0o600)
    try:
        for number in range(times):
            begun_s = time.perf_counter()
            os.pwrite(file, b"\1" * 4096, 4096 * number)
            os.fdatasync(file)
            durations_s.append(time.perf_counter() - begun_s)
    finally:
        os.close(file)
    return _timing("floor: fdatasync", durations_s)


def _bare_sqlite(path: Path, *, times: int) -> LedgerTiming:
    """Commit one row of one record at a time, without a ledger."""
    record = encode_scene_score(SCORE)
    durations_s = []
    connection = sqlite3.connect(path, isolation_level=None)
    try:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA synchronous=FULL")
        connection.execute("CREATE TABLE records (number INTEGER PRIMARY KEY, record BLOB)")
        for number in range(times):
            begun_s = time.perf_counter()
            connection.execute("INSERT INTO records VALUES (?, ?)", (number, record))
            durations_s.append(time.perf_counter() - begun_s)
    finally:
        connection.close()
    return _timing("floor: bare SQLite, one row", durations_s)


def _timing(
    what: str,
    durations_s: Sequence[float],
    *,
    wall_s: float | None = None,
    threads: int = 1,
    scenes: int = 0,
) -> LedgerTiming:
    ranked = sorted(durations_s)
    return LedgerTiming(
        what=what,
        threads=threads,
        scenes=scenes,
        per_s=round(len(ranked) / (wall_s or sum(ranked)), 1),
        median_ms=round(1e3 * ranked[len(ranked) // 2], 3),
        p99_ms=round(1e3 * ranked[int(len(ranked) * 0.99)], 3),
    )


_CLAIM: Final = ClaimRequest(worker_id=_WORKER, pipeline_version=_VERSION)

LIDAR: Final = Channel(
    topic="/lidar",
    message_encoding="cdr",
    schema_name="sensor_msgs/msg/PointCloud2",
    schema_encoding="ros2msg",
    schema_base64="",
    ids=((0, 1),),
)

_SHARES: Final = AgreementShares(
    both_static=0.9, both_dynamic=0.05, only_semantic_dynamic=0.05, only_predictive_dynamic=0.0
)

SCORE: Final = SceneScore(
    scene_id="unknown",
    log_id="unknown",
    lidar_topic=LIDAR.topic,
    vehicle="car-0",
    date="2026-01-01",
    software_version="1.0",
    start_ns=0,
    end_ns=0,
    frames=20,
    state=SceneState.SCORED,
    score=0.5,
    reasons=(Reason(headline="supervised calls pedestrian dynamic, but it is static"),),
    points=1_000_000,
    compared_share=0.8,
    all_points=_SHARES,
    nonground_points=_SHARES,
    totals=(),
    tracks=(),
    odometry=OdometryHealth(
        state=OdometryState.HEALTHY, healthy_share=1.0, static_residual_m=0.1, distance_m=5.0
    ),
    producers=Producers(supervised="s@1", selfsupervised="r@1", pipeline_version=_VERSION),
)
