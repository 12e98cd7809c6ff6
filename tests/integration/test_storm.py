"""Random kills by the dozen: the bus and the ledger alone, with miners that mine nothing."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import TransientError
from schemas.transport.keys import DEFAULT_ROOT
from service.client import ControlClient
from tests.contracts.ledger_world import expected_scenes
from tests.free_ports import free_endpoint
from tests.integration.quick_miner import SHARDS_PER_LOG
from tests.integration.witness import Witness

pytestmark = pytest.mark.integration

LOG_IDS = [f"log-{number:02d}" for number in range(12)]
SHARDS = len(LOG_IDS) * SHARDS_PER_LOG
MINERS = ("miner-0", "miner-1", "miner-2")
SEED = 7
DEADLINE_S = 200.0


class Storm:
    """Router, service and miners as processes; any of them may be killed and started again."""

    def __init__(self, folder: Path) -> None:
        (folder / "logs").mkdir()
        for log_id in LOG_IDS:
            (folder / "logs" / f"{log_id}.mcap").write_bytes(b"never opened")
        self.endpoint = free_endpoint()
        self._written = folder / "written"
        command = [sys.executable, "-m", "service.cli.main"]
        at = ["--connect", self.endpoint]
        bucket = ["--bucket", str(folder / "logs"), "--state", str(folder / "state")]
        self._commands = {
            "router": [*command, "router", "--listen", self.endpoint],
            "service": [*command, "service", *bucket, *at],
        }
        for miner in MINERS:
            module = "tests.integration.quick_miner"
            self._commands[miner] = [sys.executable, "-m", module, self.endpoint, miner]
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self.kills = 0

    @property
    def names(self) -> list[str]:
        return list(self._commands)

    def start(self, name: str) -> None:
        environment = os.environ | {
            "COUNTERPOINT_LEASE_S": "3",
            "COUNTERPOINT_MAX_ATTEMPTS": "100",
        }
        with self._written.open("ab") as written:
            self._running[name] = subprocess.Popen(
                self._commands[name], stdout=written, stderr=written, env=environment
            )

    def kill(self, name: str) -> None:
        self._running[name].kill()
        self._running[name].wait()
        self.kills += 1

    def end(self) -> None:
        for process in self._running.values():
            process.kill()
            process.wait()

    def words(self) -> str:
        return "\n".join(self._written.read_text(errors="replace").splitlines()[-60:])


@pytest.fixture
def storm(tmp_path: Path) -> Iterator[Storm]:
    raging = Storm(tmp_path)
    try:
        yield raging
    finally:
        raging.end()


def test_a_storm_of_kills_loses_no_scene_and_a_watcher_sees_each_exactly_once(
    storm: Storm,
) -> None:
    expected = expected_scenes(LOG_IDS, shards=SHARDS_PER_LOG)
    rng = np.random.default_rng(SEED)
    client = ControlClient([storm.endpoint], root=DEFAULT_ROOT)
    end_s = time.monotonic() + DEADLINE_S

    def done() -> int:
        assert time.monotonic() < end_s, storm.words()
        try:
            return client.status().shards_by_state.get("done", 0)
        except TransientError:
            return 0

    for name in storm.names:
        storm.start(name)
    while done() == 0:
        pass
    with Witness([storm.endpoint]) as witness:
        while not witness.events:
            done()
        while done() < SHARDS:
            name = str(rng.choice(storm.names))
            storm.kill(name)
            if rng.random() < 0.5:
                done()  # a moment without it
            storm.start(name)
            threading.Event().wait(rng.uniform(0.2, 1.0))
        while len(witness.events) < len(expected):
            done()

    assert storm.kills >= 5
    assert {row.scene_id: row.sha256 for row in client.top()} == expected
    assert {event.scene_id: event.sha256 for event in witness.events} == expected
    assert len(witness.events) == len(expected)
    assert client.status().parked == ()
