"""Parked work is tried again through a running service, and no death of it undoes that."""

import json
import subprocess
import sys
from pathlib import Path
from threading import Event
from typing import Any

import pytest
import structlog.testing

from schemas.errors import PermanentError
from schemas.transport.bus import client_session
from schemas.transport.keys import DEFAULT_ROOT
from schemas.work import FailRequest, PlanLease
from service.client import ControlClient
from tests.integration.daemons import System
from tests.integration.evening import counterpoint
from tests.integration.quick_miner import SHARDS_PER_LOG
from tests.integration.running import Running, two_logs
from workers.worker.lease import Leases

pytestmark = pytest.mark.integration


def park_the_first_shard(parts: Running) -> None:
    parts.world.plan_all()
    assert parts.world.fail(parts.world.mine_lease(), permanent=True).ok


def test_the_service_opens_it_and_says_so(tmp_path: Path) -> None:
    with two_logs(tmp_path) as parts:
        park_the_first_shard(parts)
        client = ControlClient([parts.endpoint], root=DEFAULT_ROOT)
        with structlog.testing.capture_logs() as events:
            assert [work.log_id for work in client.retry()] == ["a"]
            assert client.retry(["a", "b"]) == []
        assert [event for event in events if event["event"].startswith("work")] == [
            {
                "event": "work is tried again",
                "log_level": "info",
                "log_id": "a",
                "works": 1,
                "shard": "lidar-00000",
                "before": "cannot read chunk",
            }
        ]
        assert client.status().parked == ()
        assert [work.log_id for work in client.status().retried] == ["a"]
        with pytest.raises(PermanentError, match="no such log in the bucket: 'c'"):
            client.retry(["a", "c"])


def test_what_was_acknowledged_survives_the_death_of_the_service(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "a.mcap").write_bytes(b"never opened")
    system = System(tmp_path, str(tmp_path / "logs"))
    miner: subprocess.Popen[bytes] | None = None
    try:
        system.router.start()
        system.service.start()
        park_the_plan(system.endpoint)
        assert [work["error"] for work in told(system, "status")["parked"]] == ["out of memory"]
        assert told(system, "retry", "--all")["log_id"] == "a"
        system.restart(system.service)
        system.until(lambda: system.states() == {"a": "waiting"}, "the log is open again")
        module = "tests.integration.quick_miner"
        miner = subprocess.Popen([sys.executable, "-m", module, system.endpoint, "miner"])
        system.until(lambda: system.done() == SHARDS_PER_LOG, "everything is mined")
        assert told(system, "status")["parked"] == told(system, "status")["retried"] == []
    finally:
        if miner is not None:
            miner.kill()
            miner.wait()
        system.end()


def park_the_plan(endpoint: str) -> None:
    """Claim the only log there is, and fail for good, as a worker does."""
    with client_session([endpoint], stop=Event()) as session:
        leases = Leases(session, root=DEFAULT_ROOT, worker_id="unlucky")
        grant = leases.claim("p1", stop=Event()).grant
        assert isinstance(grant, PlanLease)
        request = FailRequest(
            worker_id="unlucky", lease_id=grant.lease_id, error="out of memory", permanent=True
        )
        leases.fail(request, patience_s=60)


def told(system: System, verb: str, *options: str) -> dict[str, Any]:
    """The one line that a verb prints."""
    line = counterpoint(verb, *options, "--json", "--connect", system.endpoint, env={})
    found: dict[str, Any] = json.loads(line)
    return found
