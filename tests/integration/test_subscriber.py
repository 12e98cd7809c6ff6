"""Subscribers through kills and restarts: every event of the ledger reaches them, none twice."""

import json
import os
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from schemas.errors import PermanentError, TransientError
from schemas.transport.keys import DEFAULT_ROOT
from service.client import ControlClient, watch_scenes
from service.client.subscription import RING
from tests.contracts.ledger_world import SCENES_PER_SHARD, expected_scenes
from tests.free_ports import free_endpoint
from tests.integration.quick_miner import SHARDS_PER_LOG
from tests.integration.running import Running, two_logs, until

pytestmark = pytest.mark.integration

EXAMPLE = Path(__file__).parents[2] / "deploy" / "examples" / "subscriber.py"
LOG_IDS = [f"log-{number:02d}" for number in range(10)]
SCENES_PER_LOG = SHARDS_PER_LOG * SCENES_PER_SHARD
SEED = 11
DEADLINE_S = 240.0
ENVIRONMENT = {
    "COUNTERPOINT_LEASE_S": "3",
    "COUNTERPOINT_MAX_ATTEMPTS": "100",
    "COUNTERPOINT_LIST_INTERVAL_S": "0.2",
    "COUNTERPOINT_HTTP_LISTEN": "",
    "COUNTERPOINT_WORKER_HTTP_LISTEN": "",
}


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    with two_logs(tmp_path) as parts:
        yield parts


class Fleet:
    """Router, service, miners and the ten-line subscriber, each a process of its own."""

    def __init__(self, folder: Path) -> None:
        self.logs = folder / "logs"
        self.logs.mkdir()
        for log_id in LOG_IDS:
            (self.logs / f"{log_id}.mcap").write_bytes(b"never opened")
        self.endpoint = free_endpoint()
        self.client = ControlClient([self.endpoint], root=DEFAULT_ROOT)
        self._folder, self._end_s = folder, time.monotonic() + DEADLINE_S
        command = [sys.executable, "-m", "service.cli.main"]
        bucket = ["--bucket", str(self.logs), "--state", str(folder / "state")]
        miner = [sys.executable, "-m", "tests.integration.quick_miner", self.endpoint]
        self._commands = {
            "router": [*command, "router", "--listen", self.endpoint],
            "service": [*command, "service", *bucket, "--connect", self.endpoint],
            "miner-0": [*miner, "miner-0"],
            "miner-1": [*miner, "miner-1"],
            "subscriber": [sys.executable, str(EXAMPLE), self.endpoint],
        }
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, *names: str) -> None:
        for name in names:
            # What the example writes goes to its own folder; the modules are found from here.
            where = self._folder if name == "subscriber" else None
            with (self._folder / f"{name}.log").open("ab") as written:
                self._running[name] = subprocess.Popen(
                    self._commands[name],
                    stdout=written,
                    stderr=written,
                    cwd=where,
                    env=os.environ | ENVIRONMENT,
                )

    def kill(self, name: str) -> None:
        assert self._running[name].poll() is None, self.words()
        self._running[name].kill()
        self._running[name].wait()

    def end(self) -> None:
        for process in self._running.values():
            process.kill()
            process.wait()

    def rows(self) -> list[dict[str, Any]]:
        """What the subscriber has noted: whole lines, whenever it was killed."""
        noted = self._folder / "scenes.jsonl"
        lines = noted.read_text().splitlines() if noted.exists() else []
        return [json.loads(line) for line in lines]

    def scenes_of(self, log_id: str) -> int:
        return sum(row["scene"].startswith(f"{log_id}/") for row in self.rows())

    def log_ids(self) -> set[str]:
        try:
            return {log.log_id for log in self.client.status().logs}
        except TransientError:
            return set()

    def until(self, condition: Callable[[], bool], what: str) -> None:
        while not condition():
            assert time.monotonic() < self._end_s, f"not in time: {what}\n{self.words()}"
            threading.Event().wait(0.02)

    def words(self) -> str:
        logs = sorted(self._folder.glob("*.log"))
        return "\n".join(f"--- {log.name}\n{log.read_text()[-2000:]}" for log in logs)


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    parts = Fleet(tmp_path)
    try:
        yield parts
    finally:
        parts.end()


def test_the_ten_line_subscriber_killed_twice_notes_every_event_exactly_once(fleet: Fleet) -> None:
    rng = np.random.default_rng(SEED)
    first, last = LOG_IDS[0], LOG_IDS[-1]

    def is_noted(scenes: int) -> Callable[[], bool]:
        return lambda: len(fleet.rows()) >= scenes

    fleet.start("router", "service", "miner-0", "miner-1")
    fleet.until(lambda: fleet.log_ids() == set(LOG_IDS) and bool(fleet.client.top()), "a scene")
    fleet.start("subscriber")
    fleet.until(lambda: fleet.scenes_of(first) == SCENES_PER_LOG, "the first log, noted whole")
    fleet.until(is_noted(SCENES_PER_LOG + int(rng.integers(40))), "a random moment")
    fleet.kill("subscriber")
    (fleet.logs / f"{first}.mcap").unlink()  # the dead subscriber has all its scenes
    fleet.until(lambda: fleet.log_ids() == set(LOG_IDS[1:]), "the deletion to be listed")
    fleet.start("subscriber")
    fleet.until(lambda: fleet.scenes_of(first) == 2 * SCENES_PER_LOG, "its withdrawals")
    fleet.kill("router")
    fleet.until(lambda: "service is gone" in fleet.words(), "the loss to be said")
    fleet.kill("subscriber")
    fleet.start("subscriber")  # waits for the router
    fleet.start("router")
    fleet.until(lambda: fleet.scenes_of(last) == SCENES_PER_LOG, "the last log")
    fleet.until(is_noted((len(LOG_IDS) + 1) * SCENES_PER_LOG), "every scene")
    (fleet.logs / f"{last}.mcap").unlink()  # a living subscriber hears of this one
    fleet.until(is_noted((len(LOG_IDS) + 2) * SCENES_PER_LOG), "the last withdrawals")

    rows = fleet.rows()
    seqs = [row["seq"] for row in rows]
    assert seqs == sorted(set(seqs)), "in the order of the ledger, and no number twice"
    came = Counter(row["scene"] for row in rows if row["score"] is not None)
    went = Counter(row["scene"] for row in rows if row["score"] is None)
    assert came == dict.fromkeys(expected_scenes(LOG_IDS, shards=SHARDS_PER_LOG), 1)
    assert went == dict.fromkeys(expected_scenes([first, last], shards=SHARDS_PER_LOG), 1)
    assert set(came) - set(went) == {row.scene_id for row in fleet.client.top()}


def test_whoever_resumes_gets_what_came_and_what_went_since(running: Running) -> None:
    running.world.mine_all()
    with running.watching() as watching:
        until(lambda: len(watching.events) == 18, "the history")
    since = watching.events[-1].seq
    (running.logs / "a.mcap").unlink()
    running.add_log("c")
    until(lambda: running.log_ids() == {"b", "c"}, "the listing")
    running.world.mine_all()
    with running.watching(since=since) as resumed:
        until(lambda: len(resumed.events) == 18, "what has changed")
    gone = {event.scene_id for event in resumed.events if event.withdrawn}
    came = {e.scene_id: e.sha256 for e in resumed.events if not e.withdrawn}
    assert gone == set(expected_scenes(["a"]))
    assert came == expected_scenes(["c"])
    assert resumed.seqs() == sorted(resumed.seqs())


def test_a_withdrawal_lost_on_its_way_is_fetched(running: Running) -> None:
    running.world.mine_all()
    with running.watching() as watching:
        until(lambda: len(watching.events) == 18, "the history")
        running.stop_router()
        until(lambda: watching.said == [False], "the loss of the service to be said")
        (running.logs / "a.mcap").unlink()
        until(lambda: running.log_ids() == {"b"}, "the listing")
        # As if it had been put into the void by a service that did not notice the loss in time.
        running.world.ledger.mark_published(running.world.ledger.last_seq())
        running.start_router()
        until(lambda: len(watching.events) == 27, "the withdrawals that nobody published")
        until(lambda: watching.said == [False, True], "its return to be said, once")
    assert {e.scene_id for e in watching.events[18:] if e.withdrawn} == set(expected_scenes(["a"]))


def test_the_loss_and_the_return_of_the_service_are_each_said_once(running: Running) -> None:
    with running.watching() as watching:
        running.world.mine_all()
        until(lambda: len(watching.events) == 18, "the scenes")
        running.stop_service()
        until(lambda: watching.said == [False], "the loss")
        running.start_service()
        until(lambda: watching.said == [False, True], "the return")


def test_a_reader_too_slow_for_what_is_published_gets_it_all_the_same(running: Running) -> None:
    running.world.mine_all()
    scenes = watch_scenes([running.endpoint], root=DEFAULT_ROOT, idle_s=0.3)
    seqs = [next(scenes).seq]
    logs = [f"c{number:02d}" for number in range(RING // 9 + 3)]
    for log_id in logs:
        running.add_log(log_id)
    until(lambda: running.log_ids() == {"a", "b", *logs}, "the new logs to be listed")
    running.world.mine_all()
    last = running.world.ledger.last_seq()
    until(lambda: running.world.ledger.status().published_seq == last, "their publication")
    assert last > 18 + RING
    while seqs[-1] < last:
        seqs.append(next(scenes).seq)
    assert seqs == list(range(1, last + 1))
    del scenes


def test_only_logs_vehicles_and_scores_that_are_wanted_are_yielded(running: Running) -> None:
    running.world.mine_all()
    scores = {scene.scene_id: scene.score for scene in running.world.ledger.current_scenes()}
    least = sorted(scores.values())[9]
    best = {name for name, score in scores.items() if score >= least}
    with (
        running.watching(min_score=least) as high,
        running.watching(log="[b]") as of_b,
        running.watching(vehicle=["bus-8", "bus-7"]) as of_both,
        running.watching(vehicle="bus-8") as of_none,
    ):
        until(lambda: len(of_both.events) == 18, "all scenes")
        until(lambda: {event.scene_id for event in high.events} == best, "the best scenes")
        until(lambda: of_b.digests() == expected_scenes(["b"]), "the scenes of one log")
        (running.logs / "a.mcap").unlink()
        until(lambda: len(of_both.events) == 27, "the withdrawals")
        gone = {name for name in best if name.startswith("a/")}
        until(lambda: len(high.events) == len(best) + len(gone), "the withdrawals of the best")
    assert {event.scene_id for event in high.events if event.withdrawn} == gone
    assert of_b.digests() == expected_scenes(["b"])
    assert of_none.events == []


def test_a_number_of_another_ledger_is_refused_and_not_waited_for(running: Running) -> None:
    running.world.mine_all()
    with pytest.raises(PermanentError, match=r"no event 500 here, the last is 18"):
        next(watch_scenes([running.endpoint], since=500))


def test_a_reader_that_leaves_in_the_middle_ends(running: Running) -> None:
    running.world.mine_all()
    script = f"""
from service.client import watch_scenes
for event in watch_scenes(["{running.endpoint}"]):
    raise SystemExit(7)
"""
    process = subprocess.run([sys.executable, "-c", script], timeout=30, check=False)
    assert process.returncode == 7
    scenes = watch_scenes([running.endpoint])
    assert next(scenes).seq == 1
    del scenes  # closes its session


def test_the_command_watches_from_a_number_on_and_filters(running: Running) -> None:
    running.world.mine_all()
    arguments = ["--connect", running.endpoint, "--since", "3", "--log", "b", "--json"]
    with subprocess.Popen(
        [sys.executable, "-m", "service.cli.main", "watch", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        rows = [json.loads(process.stdout.readline()) for _ in range(9)]
        running.stop_service()
        said = iter(process.stderr.readline, b"")
        assert any(b"no service answers; waiting" in line for line in said)
        running.start_service()
        assert any(b"the service is back" in line for line in said)
        process.terminate()
        assert process.wait(timeout=30) == 0
    assert {row["scene_id"] for row in rows} == set(expected_scenes(["b"]))
    assert min(row["seq"] for row in rows) > 3
