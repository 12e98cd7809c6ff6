"""What a guest on the bus puts and asks ends neither the service nor those who watch it."""

import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import structlog.testing
import zenoh
from sqlalchemy import text

from schemas.canonical import canonical_json, sha256
from schemas.transport import keys
from schemas.transport.ask import ask_until
from schemas.transport.bus import client_session, router_session
from schemas.transport.wire import encode, encode_scene_score
from schemas.work import ClaimRequest
from tests.contracts.ledger_world import START_NS, score_of
from tests.free_ports import free_endpoint
from tests.integration.daemons import Daemon
from tests.integration.running import ROOT, Running, two_logs, until

pytestmark = pytest.mark.integration


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    with two_logs(tmp_path) as parts:
        yield parts


def test_forged_scenes_neither_end_nor_mislead_a_watcher(running: Running) -> None:
    world = running.world
    with client_session([running.endpoint]) as guest, running.watching() as watching:
        world.mine_all()
        running.service._news.set()
        until(lambda: len(watching.events) == 18, "the true scenes")
        forged = encode_scene_score(score_of("forged", START_NS))
        key = keys.scene(root=ROOT, log_id="forged", scene_id=f"forged/lidar/{START_NS}")
        last = watching.seqs()[-1]
        for record, number in (
            (b"no json", b'{"seq":1}'),
            (forged, b"no number"),
            (forged, None),
            (forged, b'{"seq":-1}'),
            (forged, b'{"seq":99999999999999999999}'),
            (forged, b'{"seq":9223372036854775807}'),
            (forged, json.dumps({"seq": last + 1}).encode()),
            (b"", json.dumps({"seq": last + 2}).encode()),
        ):
            guest.put(key, record, attachment=number)
            guest.put(f"{ROOT}/v1/scene/no-scene", record, attachment=number)
            guest.delete(key, attachment=number)
        time.sleep(1.0)
        running.add_log("c")
        until(lambda: "c" in running.log_ids(), "the new log")
        world.mine_all()
        running.service._news.set()
        until(lambda: len(watching.events) >= 27, "scenes after the forged ones")
        assert watching.seqs() == list(range(1, 28)), "the true ones, each once"
        assert "forged" not in {event.log_id for event in watching.events}


def test_a_row_of_an_old_database_that_makes_no_key_is_passed_over(running: Running) -> None:
    running.world.mine_all()
    running.service._news.set()
    until(lambda: running.world.ledger.status().published_seq == 18, "all scenes published")
    with running.world.store.writing() as connection:
        before = connection.execute(text("SELECT scene_id, record FROM scenes WHERE seq = 5")).one()
        long_id = before.scene_id + "%" * 30_000
        record = canonical_json(json.loads(before.record) | {"scene_id": long_id})
        connection.execute(
            text("UPDATE scenes SET scene_id = :id, record = :record, sha256 = :sha WHERE seq = 5"),
            {"id": long_id, "record": record, "sha": sha256(record)},
        )
        connection.execute(text("UPDATE counters SET value = 0 WHERE name = 'published'"))
    with structlog.testing.capture_logs() as said:
        running.service._news.set()
        until(lambda: running.world.ledger.status().published_seq == 18, "the rest published")
    errors = [entry for entry in said if entry["log_level"] == "error"]
    assert [(entry["event"], entry["seq"]) for entry in errors] == [
        ("scene not published, ever", 5)
    ]
    registry = running.service.metrics.registry
    assert registry.get_sample_value("counterpoint_faults_total", {"part": "event"}) == 1
    with client_session([running.endpoint]) as session:
        history = session.get(
            keys.all_scenes(root=ROOT), timeout=10, consolidation=zenoh.ConsolidationMode.NONE
        )
        assert sum(reply.ok is not None for reply in history) == 17


def test_a_flood_of_questions_that_read_does_not_starve_the_workers(tmp_path: Path) -> None:
    idle_s, flooded_s = claims_under_a_flood(tmp_path, clients=8, verb="status")
    # Measured on two busy cores: without grouping and rests 20 to 40 times the idle median.
    assert flooded_s[50] < 5 * max(idle_s[50], 0.002), (idle_s, flooded_s)
    assert flooded_s[95] < 10 * max(idle_s[95], 0.005), (idle_s, flooded_s)


def test_forged_commits_of_records_that_never_come_do_not_starve_the_workers(
    tmp_path: Path,
) -> None:
    idle_s, flooded_s = claims_under_a_flood(tmp_path, clients=32, verb="commit")
    # Where each of them waits for its records, no thread is left: two waits of 0.2 s a claim.
    assert flooded_s[50] < max(10 * idle_s[50], 0.1), (idle_s, flooded_s)


def claims_under_a_flood(
    folder: Path, *, clients: int, verb: str
) -> tuple[list[float], list[float]]:
    """Claim 100 times before a flood and 100 times during it.

    Args:
        folder: For state and logs.
        clients: Of the flood.
        verb: That they ask.

    Returns:
        How long each claim took, seconds, the shortest first: before, and during the flood.
    """
    endpoint = free_endpoint()
    (folder / "logs").mkdir()
    for number in range(2000):
        (folder / "logs" / f"log-{number:04d}.mcap").write_bytes(b"never opened")
    at = ("--connect", endpoint, "--bucket", str(folder / "logs"))
    daemon = Daemon(folder, "service", "service", *at, "--state", str(folder / "state"))
    with router_session([endpoint]), client_session([endpoint]) as session:
        daemon.start()
        try:
            claims(session, 20, patience_s=60)
            idle_s = claims(session, 100)
            flooder = [sys.executable, "-m", "tests.integration.flooder"]
            asked = [*flooder, endpoint, str(clients), verb]
            with subprocess.Popen(asked, stdout=subprocess.PIPE) as flooding:
                assert flooding.stdout is not None
                try:
                    assert flooding.stdout.readline() == b"flooding\n"
                    return idle_s, claims(session, 100)
                finally:
                    flooding.kill()
        finally:
            daemon.end()


def claims(session: zenoh.Session, count: int, *, patience_s: float = 20) -> list[float]:
    """Claim so often; return how long each took, seconds, the shortest first."""
    took = []
    for number in range(count):
        request = encode(ClaimRequest(worker_id=f"w{number}", pipeline_version="p1"))
        key = keys.control(root=ROOT, verb="claim")
        began_s = time.perf_counter()
        ask_until(session, key, request, stop=threading.Event(), patience_s=patience_s)
        took.append(time.perf_counter() - began_s)
    return sorted(took)
