"""Router, service and workers killed in the middle of their work: nothing lost, nothing changed."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from schemas.bucket import open_bucket
from schemas.bus import free_endpoint
from schemas.errors import TransientError
from schemas.keys import DEFAULT_ROOT
from schemas.recordings import group_recordings
from schemas.wire import encode_scene_score, sha256
from service.client import ControlClient, watch_scenes
from service.config import load_settings
from service.status import Status
from workers.score import score_recording
from workers.simulation.lidar import UNEVEN_64, Lidar
from workers.simulation.recorded import plan_mistakes
from workers.simulation.worlds import build_street
from workers.simulation.write import Identity, write_log

pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]

LOGS, SECONDS, SHARD_S = 2, 10, 2
SHARDS = LOGS * SECONDS // SHARD_S
DEADLINE_S = 300.0
"""For any one thing to happen; generous, since machines that run tests are busy."""


class Daemon:
    """One process of the system, under a name; killed and started again at will."""

    def __init__(self, folder: Path, name: str, *arguments: str) -> None:
        self.name = name
        self._arguments = arguments
        self._log = folder / f"{name}.log"
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "service.cli.main", *self._arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=os.environ
                | {
                    "OMP_NUM_THREADS": "1",
                    "COUNTERPOINT_LEASE_S": "6",
                    "COUNTERPOINT_MAX_ATTEMPTS": "20",
                },
            )

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def kill(self) -> None:
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def stop(self) -> int:
        assert self._process is not None
        self._process.terminate()
        return self._process.wait(timeout=60)

    def end(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self.kill()

    def words(self) -> str:
        lines = self._log.read_text(errors="replace").splitlines() if self._log.exists() else []
        return f"--- {self.name}\n" + "\n".join(lines[-40:])


class System:
    """All daemons of one run, and what the service says of it."""

    def __init__(self, folder: Path, logs: Path) -> None:
        self.endpoint = free_endpoint()
        state, shard_s = str(folder / "state"), str(SHARD_S)
        at = ("--connect", self.endpoint)
        self.router = Daemon(folder, "router", "router", "--listen", self.endpoint)
        self.service = Daemon(
            folder,
            "service",
            *("service", "--bucket", str(logs), "--state", state, *at),
            *("--shard-seconds", shard_s, "--supervised", "recorded"),
        )
        self.pool = Daemon(folder, "pool", "worker", "--workers", "2", *at)
        self.daemons = (self.router, self.service, self.pool)
        self.client = ControlClient([self.endpoint], root=DEFAULT_ROOT)

    def status(self) -> Status | None:
        try:
            return self.client.status()
        except TransientError:
            return None

    def done(self) -> int:
        status = self.status()
        return status.shards_by_state.get("done", 0) if status is not None else -1

    def is_mined(self) -> bool:
        status = self.status()
        return status is not None and status.shards_by_state == {"done": SHARDS}

    def until(self, condition: Callable[[], bool], what: str) -> None:
        end_s = time.monotonic() + DEADLINE_S
        while not condition():
            if time.monotonic() > end_s:
                words = "\n".join(daemon.words() for daemon in self.daemons)
                pytest.fail(f"not within {DEADLINE_S:g} s: {what}\n{self.status()}\n{words}")
            time.sleep(0.05)

    def until_done(self, shards: int) -> None:
        self.until(lambda: self.done() >= shards, f"{shards} shards done")

    def kill_worker(self) -> None:
        """Kill one worker of the pool in mid-shard: the pool must start another."""
        self.until(lambda: bool(_workers_of(self.pool.pid)), "a worker")
        os.kill(_workers_of(self.pool.pid)[0], signal.SIGKILL)

    def restart(self, *daemons: Daemon) -> None:
        for daemon in daemons:
            daemon.kill()
        for daemon in daemons:
            daemon.start()


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bucket of small streets, labelled by a model on the car that errs now and then."""
    folder = tmp_path_factory.mktemp("chaos") / "logs"
    lidar = Lidar(elevation_deg=UNEVEN_64[::2], columns=192)
    for seed in range(LOGS):
        street = build_street(seed, seconds=SECONDS, style="stands")
        write_log(
            folder / f"car-{seed}" / "2026-03-02" / "drive.mcap",
            street,
            lidar=lidar,
            identity=Identity(vehicle=f"car-{seed}"),
            mistakes=plan_mistakes(street, lidar=lidar),
            chunk_bytes=1 << 18,
        )
    return folder


@pytest.fixture
def system(tmp_path: Path, logs: Path) -> Iterator[System]:
    running = System(tmp_path, logs)
    try:
        yield running
    finally:
        for daemon in running.daemons:
            daemon.end()


@pytest.fixture(scope="module")
def undisturbed(logs: Path) -> dict[str, str]:
    """Scene id to digest, from mining that nobody disturbs, without a bus."""
    settings = load_settings(
        bucket=str(logs), grid={"shard_s": SHARD_S}, supervised="recorded"
    ).mining()
    bucket = open_bucket(str(logs))
    scores = [
        score
        for recording in group_recordings(bucket.list())
        for score in score_recording(bucket, recording, settings)
    ]
    assert any(score.tracks for score in scores), "nothing that a kill could change"
    return {score.scene_id: sha256(encode_scene_score(score)) for score in scores}


def test_kills_in_mid_run_change_no_record_and_a_late_client_gets_them_all(
    system: System, undisturbed: dict[str, str]
) -> None:
    assert len(undisturbed) == SHARDS
    for daemon in system.daemons:
        daemon.start()
    system.until_done(1)
    system.restart(system.service)
    system.until_done(2)
    system.kill_worker()
    system.until_done(3)
    system.restart(system.router)
    system.until_done(5)
    system.restart(system.router, system.service)
    system.until_done(6)
    system.kill_worker()
    system.restart(system.service)
    system.until_done(8)
    system.restart(system.router)
    system.until(system.is_mined, "every shard done")

    assert {row.scene_id: row.sha256 for row in system.client.top()} == undisturbed
    assert _received_late(system.endpoint, len(undisturbed)) == undisturbed
    assert [daemon.stop() for daemon in (system.pool, system.service, system.router)] == [0, 0, 0]


def _received_late(endpoint: str, scenes: int) -> dict[str, str]:
    received: dict[str, str] = {}
    for event in watch_scenes([endpoint], root=DEFAULT_ROOT):
        received[event.scene_id] = event.sha256
        if len(received) == scenes:
            break
    return received


def _workers_of(pool: int) -> list[int]:
    """Children of the pool that run a worker, from the kernel's list."""
    threads = Path(f"/proc/{pool}/task").iterdir()
    children = [child for at in threads for child in (at / "children").read_text().split()]
    return sorted(int(child) for child in children if "spawn_main" in _command_line(int(child)))


def _command_line(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return ""
