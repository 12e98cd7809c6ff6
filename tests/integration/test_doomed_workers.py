"""Workers that die in each lease, and shards that kill each worker: real processes, both databases.

Miners mine nothing here (`quick_miner`); router, service, leases and commits are the product's.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import create_engine, select, text

from schemas.errors import CounterpointError
from service.store.engine import open_store_to_read
from service.store.tables import LEASES
from tests.contracts.databases import postgres_server
from tests.factories import street_log
from tests.integration.daemons import QUICK, System, workers_of
from tests.integration.quick_miner import SHARDS_PER_LOG

pytestmark = [pytest.mark.integration, pytest.mark.timeout(600)]

LOGS = ("log-0", "log-1")
SHARDS = len(LOGS) * SHARDS_PER_LOG
POISON = "log-0:3"


@pytest.fixture(scope="module")
def postgres() -> Iterator[str]:
    with postgres_server() as url:
        yield url


@pytest.fixture(params=["sqlite", "postgres"])
def system(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[System]:
    """Router and service over two logs, on either database; a lost lease costs three seconds."""
    (tmp_path / "logs").mkdir()
    for log_id in LOGS:
        (tmp_path / "logs" / f"{log_id}.mcap").write_bytes(b"never opened")
    options: tuple[str, ...] = ()
    if request.param == "postgres":
        server, name = request.getfixturevalue("postgres"), f"doomed_{os.urandom(4).hex()}"
        admin = create_engine(f"{server}/postgres", isolation_level="AUTOCOMMIT")
        with admin.connect() as connection:
            connection.execute(text(f"CREATE DATABASE {name}"))
        admin.dispose()
        options = ("--database", f"{server}/{name}".replace("+psycopg", ""))
    policy = {"COUNTERPOINT_LEASE_S": "3", "COUNTERPOINT_MAX_ATTEMPTS": "5"}
    running = System(tmp_path, str(tmp_path / "logs"), *options, env=policy)
    try:
        running.router.start()
        running.service.start()
        yield running
    finally:
        running.end()


class Miners:
    """Miners in their places: who dies is replaced at once, under the same id."""

    def __init__(self, endpoint: str) -> None:
        self._endpoint = endpoint
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []
        self.deaths = 0

    def add(self, worker_id: str, *, dies_of: str = "", record_s: float = 0.02) -> None:
        how = (worker_id, dies_of, str(record_s))
        self._threads.append(threading.Thread(target=self._keep, args=how))
        self._threads[-1].start()

    def _keep(self, *how: str) -> None:
        module = "tests.integration.quick_miner"
        while not self._stop.is_set():
            miner = subprocess.Popen([sys.executable, "-m", module, self._endpoint, *how])
            while miner.poll() is None and not self._stop.wait(0.05):
                pass
            if miner.poll() is None:
                miner.kill()
            self.deaths += miner.wait() == -signal.SIGKILL and not self._stop.is_set()

    def __enter__(self) -> "Miners":
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()


def settled(system: System) -> bool:
    status = system.status()
    if status is None or len(status.logs) < len(LOGS):
        return False
    states = status.shards_by_state
    return sum(states.get(state, 0) for state in ("done", "parked")) == SHARDS


def test_workers_that_die_in_each_lease_park_nothing_beside_a_healthy_one(system: System) -> None:
    with Miners(system.endpoint) as miners:
        for place in range(3):
            miners.add(f"worker-bad-pool1-{place}", dies_of="each")
        miners.add("worker-good-pool2-0", record_s=1.2)
        system.until(lambda: settled(system), "all shards done or parked")
    status = system.client.status()
    assert miners.deaths > 5
    assert status.parked == ()
    assert status.shards_by_state == {"done": SHARDS}


def test_a_shard_that_kills_each_worker_is_parked_and_the_rest_is_done(system: System) -> None:
    with Miners(system.endpoint) as miners:
        for place in range(2):
            miners.add(f"worker-good-pool1-{place}", dies_of=POISON)
        system.until(lambda: settled(system), "all shards done or parked")
    status = system.client.status()
    assert 5 <= miners.deaths <= 10
    assert [(work.log_id, work.shard) for work in status.parked] == [("log-0", "lidar-00003")]
    assert status.shards_by_state == {"done": SHARDS - 1, "parked": 1}


def test_a_run_that_mines_once_ends_with_3_and_names_what_is_parked(tmp_path: Path) -> None:
    street_log(tmp_path / "logs" / "a.mcap", frames=60, seed=0, style="stands")
    state = tmp_path / "state"
    command = [sys.executable, "-m", "service.cli.main", "run", "--once", "--workers", "1"]
    at = ["--bucket", str(tmp_path / "logs"), "--state", str(state)]
    how = ["--shard-seconds", "2", "--supervised", "recorded"]
    env = os.environ | QUICK | {"COUNTERPOINT_MAX_ATTEMPTS": "1"}
    with subprocess.Popen(
        [*command, *at, *how], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env
    ) as run:
        killing = threading.Thread(target=kill_on_shard, args=(run, state, "-00001"))
        killing.start()
        said = run.communicate(timeout=400)[1]
        killing.join()
    assert run.returncode == 3, said
    (line,) = [line for line in said.splitlines() if line.startswith("error: ")]
    assert "1 shard of 1 log parked, their scenes are missing: a (1 shard)" in line
    assert f"counterpoint retry --all --state {state}" in line.replace(sys.argv[0], "counterpoint")
    status = [sys.executable, "-m", "service.cli.main", "status", "--state", str(state)]
    told = subprocess.run([*status, "--json"], capture_output=True, text=True, check=True).stdout
    found = json.loads(told)
    assert found["shards_by_state"] == {"done": 2, "parked": 1}
    assert [work["log_id"] for work in found["parked"]] == ["a"]


def kill_on_shard(run: "subprocess.Popen[str]", state: Path, shard: str) -> None:
    """Kill the only worker of a run as soon as it holds the lease of this shard."""
    while run.poll() is None:
        time.sleep(0.005)
        try:
            with closing(open_store_to_read(state)) as store:
                while run.poll() is None:
                    with store.reading() as connection:
                        held = select(LEASES.c.shard).where(LEASES.c.is_held)
                        holds = any(
                            name.endswith(shard) for name in connection.execute(held).scalars()
                        )
                    if holds:
                        os.kill(workers_of(run.pid)[0], signal.SIGKILL)
                        return
                    time.sleep(0.005)
        except (CounterpointError, OSError):  # not there yet
            continue
