"""Benchmark of a fleet: many workers by the real protocol, mining replaced by its measured time.

Router and service are processes as an operator starts them. The workers are threads of this
process, each with a Zenoh session of its own; they claim, renew, publish and commit like workers.
"""

import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.canonical import sha256
from schemas.errors import TransientError
from schemas.runtime.retry import StoppedError
from schemas.transport import keys
from schemas.transport.bus import client_session, recoverable_publisher
from schemas.work import (
    CommitRequest,
    ManifestEntry,
    MineLease,
    MiningStats,
    NothingToDo,
    PlanLease,
)
from service.store.bench_ledger import made_up_plan, made_up_records
from workers.worker.lease import LeaseKeeper, Leases

VERSION: Final = "bench"
SHARDS_PER_LOG: Final = 20
START_DEADLINE_S: Final = 120.0
STOP_DEADLINE_S: Final = 30.0


class FleetTiming(BaseModel):
    """Efficiency of a fleet of simulated workers, and cost of its service.

    Attributes:
        workers: Number of workers.
        mine_s: Time that each shard is mined, seconds.
        wall_s: Measured time, from the moment when every worker mines, seconds.
        shards: Shards committed in that time.
        efficiency: Sum of mining time over the measured time and the workers.
        start_s: Time until every worker mined, seconds.
        service_start_mb: Memory of the service when the measurement began, MB.
        service_end_mb: Memory of the service at its end, MB.
        service_cpu: Cores that the service took.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    workers: int = Field(ge=1)
    mine_s: float
    wall_s: float
    shards: int = Field(ge=0)
    efficiency: float
    start_s: float
    service_start_mb: float
    service_end_mb: float
    service_cpu: float


def bench_fleet(
    folder: Path,
    *,
    workers: int,
    mine_s: float,
    seconds: float,
    scenes_per_shard: int,
    on_progress: Callable[[str], None] = lambda _: None,
) -> FleetTiming:
    """Run a fleet for a while.

    Args:
        folder: On the disk for the state; logs and state are made in it.
        workers: Number of workers.
        mine_s: Time that each shard is mined, seconds.
        seconds: Measured time.
        scenes_per_shard: Records in one commit.
        on_progress: Called with what happens.

    Raises:
        TransientError: If the service or the workers do not start.
    """
    logs = 2 + int(workers * (seconds + START_DEADLINE_S) / mine_s / SHARDS_PER_LOG)
    _make_logs(folder / "logs", logs)
    with ExitStack() as opened:
        on_progress("starting")
        endpoint = f"tcp/127.0.0.1:{_free_port()}"
        opened.enter_context(_daemon(folder, "router", "--listen", endpoint))
        settings = folder / "service.toml"
        settings.write_text('http_listen = ""', encoding="utf-8")  # another may have the pages
        service = opened.enter_context(
            _daemon(
                *(folder, "service", "--connect", endpoint, "--state", str(folder / "state")),
                *("--bucket", str(folder / "logs"), "--log-level", "warning"),
                *("--config", str(settings)),
            )
        )
        fleet = _Fleet(endpoint, mine_s=mine_s, scenes_per_shard=scenes_per_shard)
        began_s = time.monotonic()
        opened.callback(fleet.end)
        fleet.start(workers)
        while fleet.mining() < workers:
            if service.poll() is not None or time.monotonic() - began_s > START_DEADLINE_S:
                raise TransientError("the fleet did not start: service or workers gave up")
            time.sleep(0.05)
        start_s = time.monotonic() - began_s
        on_progress("measuring")
        memory_mb, cpu_s, mined_s = _memory_mb(service), _cpu_s(service), fleet.mined_s()
        shards, began_s = fleet.shards(), time.monotonic()
        time.sleep(seconds)
        wall_s = time.monotonic() - began_s
        return FleetTiming(
            workers=workers,
            mine_s=mine_s,
            wall_s=round(wall_s, 1),
            shards=fleet.shards() - shards,
            efficiency=round((fleet.mined_s() - mined_s) / wall_s / workers, 4),
            start_s=round(start_s, 1),
            service_start_mb=round(memory_mb, 1),
            service_end_mb=round(_memory_mb(service), 1),
            service_cpu=round((_cpu_s(service) - cpu_s) / wall_s, 3),
        )


@dataclass(slots=True)
class _Tally:
    """Work of one worker, written by its thread alone."""

    shards: int = 0
    mined_s: float = 0.0
    mining_since_s: float | None = None


@dataclass
class _Fleet:
    endpoint: str
    mine_s: float
    scenes_per_shard: int
    stop: Event = field(default_factory=Event)
    tallies: list[_Tally] = field(default_factory=list)
    threads: list[threading.Thread] = field(default_factory=list)

    def start(self, workers: int) -> None:
        for number in range(workers):
            tally = _Tally()
            thread = threading.Thread(
                target=self._work, args=(f"bench-{number}", tally), name=f"worker-{number}"
            )
            self.tallies.append(tally)
            self.threads.append(thread)
            thread.start()

    def end(self) -> None:
        self.stop.set()
        for thread in self.threads:
            thread.join(STOP_DEADLINE_S)

    def mining(self) -> int:
        """Return how many workers mine, or have mined."""
        return sum(bool(each.mined_s or each.mining_since_s) for each in self.tallies)

    def shards(self) -> int:
        return sum(each.shards for each in self.tallies)

    def mined_s(self) -> float:
        """Return the time that all workers have mined until now, seconds."""
        now_s, total = time.monotonic(), 0.0
        for each in self.tallies:
            since_s = each.mining_since_s
            total += each.mined_s + (0.0 if since_s is None else now_s - since_s)
        return total

    def _work(self, worker_id: str, tally: _Tally) -> None:
        try:
            with client_session([self.endpoint], stop=self.stop) as session:
                leases = Leases(session, root=keys.DEFAULT_ROOT, worker_id=worker_id)
                key = keys.score(root=keys.DEFAULT_ROOT, worker_id=worker_id)
                with recoverable_publisher(session, key) as publisher:
                    while not self.stop.is_set():
                        self._next(leases, publisher.put, tally)
        except StoppedError:
            return

    def _next(self, leases: Leases, publish: Callable[[bytes], None], tally: _Tally) -> None:
        leases.hello(stop=self.stop)
        lease = leases.claim(VERSION, stop=self.stop).grant
        if isinstance(lease, NothingToDo):
            self.stop.wait(lease.retry_after_s)
            return
        with LeaseKeeper(leases, lease, stop=self.stop, drain_s=2.0) as keeper:
            if isinstance(lease, PlanLease):
                plan = made_up_plan(
                    lease.recording.log_id,
                    shards=SHARDS_PER_LOG,
                    scenes_per_shard=self.scenes_per_shard,
                )
                request = CommitRequest(
                    worker_id=leases.worker_id, lease_id=lease.lease_id, plan=plan
                )
                leases.commit(request, stop=keeper.drained)
                return
            self._mine(leases, publish, lease, keeper, tally)

    def _mine(
        self,
        leases: Leases,
        publish: Callable[[bytes], None],
        lease: MineLease,
        keeper: LeaseKeeper,
        tally: _Tally,
    ) -> None:
        records = dict(made_up_records(lease.shard))
        for record in records.values():
            tally.mining_since_s = time.monotonic()
            keeper.over.wait(self.mine_s / len(records))
            tally.mined_s += time.monotonic() - tally.mining_since_s
            tally.mining_since_s = None
            publish(record)
        request = CommitRequest(
            worker_id=leases.worker_id,
            lease_id=lease.lease_id,
            manifest=tuple(
                ManifestEntry(scene_id=scene_id, sha256=sha256(record))
                for scene_id, record in records.items()
            ),
            stats=MiningStats(frames=20 * len(records), stage_s={"mining": self.mine_s}),
        )
        while True:
            answer = leases.commit(request, stop=keeper.drained)
            if answer.ok or not answer.missing:
                tally.shards += answer.ok
                return
            again = tuple(records[scene_id].decode() for scene_id in answer.missing)
            request = request.model_copy(update={"records": again})


def _make_logs(folder: Path, logs: int) -> None:
    folder.mkdir()
    for number in range(logs):
        (folder / f"drive-{number:05d}.mcap").write_bytes(b"made-up log, never opened")


@contextmanager
def _daemon(folder: Path, *command: str) -> Iterator[subprocess.Popen[bytes]]:
    with (folder / f"{command[0]}.log").open("wb") as log:
        process = subprocess.Popen(  # noqa: S603  # our own program
            [sys.executable, "-m", "service.cli", *command], stdout=log, stderr=log
        )
        try:
            yield process
        finally:
            process.terminate()
            process.wait(STOP_DEADLINE_S)


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def _memory_mb(process: subprocess.Popen[bytes]) -> float:
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
    line = next(line for line in status.splitlines() if line.startswith("VmRSS:"))
    return int(line.split()[1]) / 1e3


def _cpu_s(process: subprocess.Popen[bytes]) -> float:
    """Return the processor time of a process, seconds."""
    told = Path(f"/proc/{process.pid}/stat").read_text(encoding="utf-8")
    fields = told.rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
