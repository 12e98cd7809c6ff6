"""A worker's loop for a day in minutes: real leases, publishing and commits, made-up mining.

Each record is as large as one of a busy street; a shard takes as long as the caller says.
"""

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from threading import Event
from typing import TextIO

import zenoh

from schemas.canonical import sha256
from schemas.contradiction import ContradictionKind, InstanceRecord, TrackRecord
from schemas.runtime.process import stop_on_signals
from schemas.runtime.retry import StoppedError
from schemas.transport import keys
from schemas.transport.bus import client_session, recoverable_publisher
from schemas.transport.wire import encode_scene_score
from schemas.work import (
    CommitRequest,
    ManifestEntry,
    MineLease,
    MiningStats,
    NothingToDo,
    PlanLease,
    Shard,
)
from tests.contracts.ledger_world import plan_of, score_of
from workers.worker.lease import LeaseKeeper, Leases

SHARDS_PER_LOG = 10
SCENES_PER_SHARD = 10
TRACKS = 4


def main(endpoint: str, worker_id: str, mine_s: str, commits: str) -> None:
    """Work until told to stop, and note how long each commit took."""
    with (
        stop_on_signals() as stop,
        Path(commits).open("w", buffering=1) as noted,
        client_session([endpoint], stop=stop) as session,
    ):
        leases = Leases(session, root=keys.DEFAULT_ROOT, worker_id=worker_id)
        key = keys.score(root=keys.DEFAULT_ROOT, worker_id=worker_id)
        try:
            with recoverable_publisher(session, key) as publisher:
                while not stop.is_set():
                    _next(publisher, leases, stop, mine_s=float(mine_s), noted=noted)
        except StoppedError:
            return


def _next(
    publisher: zenoh.ext.AdvancedPublisher,
    leases: Leases,
    stop: Event,
    *,
    mine_s: float,
    noted: TextIO,
) -> None:
    leases.hello(stop=stop)
    lease = leases.claim("day-1", stop=stop).grant
    if isinstance(lease, NothingToDo):
        stop.wait(lease.retry_after_s)
        return
    with LeaseKeeper(leases, lease, stop=stop, drain_s=2.0) as keeper:
        if isinstance(lease, PlanLease):
            plan = plan_of(lease.recording.log_id, shards=SHARDS_PER_LOG, cells=SCENES_PER_SHARD)
            request = CommitRequest(worker_id=leases.worker_id, lease_id=lease.lease_id, plan=plan)
            leases.commit(request, stop=keeper.drained)
        else:
            _mine(publisher, leases, lease, keeper, mine_s=mine_s, noted=noted)


def _mine(
    publisher: zenoh.ext.AdvancedPublisher,
    leases: Leases,
    lease: MineLease,
    keeper: LeaseKeeper,
    *,
    mine_s: float,
    noted: TextIO,
) -> None:
    records: dict[str, bytes] = {}
    for scene_id, record in records_of(lease.shard):
        keeper.over.wait(mine_s / SCENES_PER_SHARD)
        publisher.put(record)
        records[scene_id] = record
    request = CommitRequest(
        worker_id=leases.worker_id,
        lease_id=lease.lease_id,
        manifest=tuple(
            ManifestEntry(scene_id=scene_id, sha256=sha256(record))
            for scene_id, record in records.items()
        ),
        stats=MiningStats(frames=20 * len(records), points=1000 * len(records)),
    )
    while True:
        begun_s = time.perf_counter()
        answer = leases.commit(request, stop=keeper.drained)
        noted.write(f"{time.perf_counter() - begun_s:.6f}\n")
        if answer.ok or not answer.missing:
            return
        again = tuple(records[scene_id].decode() for scene_id in answer.missing)
        request = request.model_copy(update={"records": again})


def records_of(shard: Shard) -> Iterator[tuple[str, bytes]]:
    """Yield id and record of every scene of a shard, the same whenever it is mined."""
    step_ns = (shard.end_ns - shard.start_ns) // SCENES_PER_SHARD
    for start_ns in range(shard.start_ns, shard.end_ns, step_ns):
        score = score_of(shard.log_id, start_ns, pipeline_version="day-1")
        tracks = tuple(_track(number, start_ns) for number in range(TRACKS))
        yield score.scene_id, encode_scene_score(score.model_copy(update={"tracks": tracks}))


def _track(number: int, start_ns: int) -> TrackRecord:
    return TrackRecord(
        track_id=number,
        kind=ContradictionKind.ONLY_SEMANTIC_DYNAMIC,
        class_name="pedestrian",
        strength=0.5 / (number + 1),
        first_ns=start_ns,
        last_ns=start_ns,
        frames=12,
        points=240,
        speed_m_per_s=1.25,
        strongest=InstanceRecord(
            stamp_ns=start_ns,
            points=40,
            centre_m=(12.125, -3.25, 0.5),
            size_m=(0.625, 0.5, 1.75),
            yaw_rad=0.125,
            range_m=12.562,
            semantic_confidence=0.875,
            predictive_confidence=0.75,
        ),
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
