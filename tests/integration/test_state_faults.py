"""Real faults in mid-run of what the ledger stands on: said, measured, survived, nothing lost."""

import json
import os
import re
import sqlite3
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from http.client import HTTPConnection
from itertools import repeat
from pathlib import Path

import pytest

from schemas.errors import TransientError
from schemas.transport.keys import DEFAULT_ROOT
from service.client import ControlClient
from service.curation.status import Status
from service.store.engine import DATABASE_NAME
from tests.contracts.ledger_world import expected_scenes
from tests.free_ports import free_endpoint
from tests.integration.daemons import Daemon
from tests.integration.quick_miner import SHARDS_PER_LOG
from tests.integration.steered_clock import steered_clock
from tests.needed import need

pytestmark = pytest.mark.integration

LOG_IDS = [f"log-{number:02d}" for number in range(10)]
SHARDS = len(LOG_IDS) * SHARDS_PER_LOG
DEADLINE_S = 240.0

TROUBLE = r"(trying again|request not answered now) .*cannot use the database: "
FULL = f"{TROUBLE}database or disk is full"
UNWRITABLE = f"{TROUBLE}(attempt to write a readonly database|disk I/O error)"
LOCKED = f"{TROUBLE}database is locked"
SENTENCE_ENDS = r" \(.*\); nothing acknowledged is lost, try again when that is fixed"
AGAIN = "works again|requests answered again"

DATABASE_ERRORS = "counterpoint_database_errors_total"
CLOCK_SET_BACK = 'counterpoint_clock_steps_total{direction="back"}'
CLOCK_SET_FORWARD = 'counterpoint_clock_steps_total{direction="forward"}'


class Run:
    """Router, service and two miners that mine nothing, on a state folder of the test's choice."""

    def __init__(self, folder: Path, state: Path, env: dict[str, str]) -> None:
        (folder / "logs").mkdir()
        for log_id in LOG_IDS:
            (folder / "logs" / f"{log_id}.mcap").write_bytes(b"never opened")
        self.state, self._folder = state, folder
        self.endpoint = free_endpoint()
        self.http = free_endpoint().removeprefix("tcp/")
        self.client = ControlClient([self.endpoint], root=DEFAULT_ROOT)
        self.router = Daemon(folder, "router", "router", "--listen", self.endpoint)
        self.service = Daemon(
            folder,
            "service",
            *("service", "--bucket", str(folder / "logs"), "--state", str(state)),
            *("--connect", self.endpoint),
            env={
                "COUNTERPOINT_HTTP_LISTEN": self.http,
                "COUNTERPOINT_LIST_INTERVAL_S": "1",
                "COUNTERPOINT_MAX_ATTEMPTS": "5",
                "COUNTERPOINT_LEASE_S": "30",
            }
            | env,
        )
        self._miners: list[subprocess.Popen[bytes]] = []

    def start(self) -> None:
        self.router.start()
        self.service.start()
        for number in range(2):
            self._start_miner(f"miner-{number}")

    def _start_miner(self, name: str) -> None:
        with (self._folder / "miners.log").open("ab") as log:
            module = "tests.integration.quick_miner"
            command = [sys.executable, "-m", module, self.endpoint, name]
            self._miners.append(subprocess.Popen(command, stdout=log, stderr=log))

    def kill_miner(self) -> None:
        """Kill one that is at work, and put another in its place: its lease is left to expire."""
        miner = self._miners.pop(0)
        miner.kill()
        miner.wait()
        self._start_miner(f"after-{miner.pid}")

    def end(self) -> None:
        for miner in self._miners:
            miner.kill()
            miner.wait()
        self.service.end()
        self.router.end()

    def status(self) -> Status | None:
        try:
            return self.client.status()
        except TransientError:
            return None

    def done(self) -> int:
        status = self.status()
        return -1 if status is None else status.shards_by_state.get("done", 0)

    def lines(self, pattern: str) -> list[str]:
        """Lines of the service's log that match."""
        return [line for line in self.service.said().splitlines() if re.search(pattern, line)]

    def until_said(self, pattern: str) -> None:
        self.until(lambda: bool(self.lines(pattern)), f"the log says {pattern!r}")

    def metric(self, name: str) -> float:
        _, text = answer(self.http, "/metrics")
        found = re.search(rf"^{re.escape(name)} (\S+)$", text, re.MULTILINE)
        assert found is not None, f"no metric {name}"
        return float(found.group(1))

    def readiness(self) -> dict[str, str]:
        """What keeps the service from its work, as `/readyz` has it; empty: it is ready."""
        status, text = answer(self.http, "/readyz")
        found = json.loads(text)
        problems: dict[str, str] = found["problems"]
        assert (status, found["ready"]) == ((503, False) if problems else (200, True))
        return problems

    def until_unready(self, because: str) -> None:
        """Wait until `/readyz` says that the database can be read only, and why."""

        def is_unready() -> bool:
            problem = self.readiness().get("database", "")
            return re.search(f"can be read, but not written: .*({because})", problem) is not None

        self.until(is_unready, f"/readyz says {because!r}")

    def until_ready(self) -> None:
        self.until(lambda: not self.readiness(), "/readyz is well again")

    def until_counted(self, name: str) -> None:
        self.until(lambda: self.metric(name) > 0, f"{name} grows")

    def until(self, condition: Callable[[], bool], what: str) -> None:
        end_s = time.monotonic() + DEADLINE_S
        while not condition():
            if time.monotonic() > end_s or not self.service.is_running():
                pytest.fail(f"not in time: {what}\n{self.status()}\n{self.service.words()}")
            time.sleep(0.05)

    def assert_complete(self) -> None:
        """Everything is mined as if nothing had been: no scene lost, changed, twice or parked."""
        self.until(lambda: self.done() == SHARDS, "every shard done")
        expected = expected_scenes(LOG_IDS, shards=SHARDS_PER_LOG)
        assert {row.scene_id: row.sha256 for row in self.client.top()} == expected
        status = self.client.status()
        assert status.parked == ()
        assert status.last_seq == len(expected)
        assert self.service.stop() == 0
        assert self.router.is_running()


def answer(address: str, path: str) -> tuple[int, str]:
    """Status and body of a page."""
    connection = HTTPConnection(address, timeout=60)
    with closing(connection):
        connection.request("GET", path)
        reply = connection.getresponse()
        return reply.status, reply.read().decode()


@contextmanager
def mounted(point: Path, *arguments: str) -> Iterator[Path]:
    """Mount a file system of the test's own.

    In CI it is a failure if that is not allowed, elsewhere the test is skipped and says so.
    """
    point.mkdir(exist_ok=True)
    tried = subprocess.run(["mount", *arguments, str(point)], capture_output=True, text=True)
    if tried.returncode != 0:
        need(f"this test must mount a small file system, run it as root: {tried.stderr}")
    try:
        yield point
    finally:
        subprocess.run(["umount", "--lazy", str(point)], check=True)


@contextmanager
def disk_image(folder: Path) -> Iterator[Path]:
    """Mount an ext4 file system from a file, which goes read-only at its first error."""
    image = folder / "disk.img"
    with image.open("wb") as file:
        file.truncate(32 << 20)
    subprocess.run(["mkfs.ext4", "-q", "-O", "^has_journal", str(image)], check=True)
    with mounted(folder / "state", "-o", "loop,errors=remount-ro", str(image)) as point:
        yield point


@contextmanager
def running(folder: Path, state: Path, env: dict[str, str] | None = None) -> Iterator[Run]:
    """Have some of the work done, and nothing wrong so far."""
    run = Run(folder, state, env or {})
    try:
        run.start()
        run.until(lambda: run.done() >= 5, "five shards done")
        assert run.metric(DATABASE_ERRORS) == 0, run.service.words()
        assert not run.lines(TROUBLE), run.service.words()
        yield run
    finally:
        run.end()


def fill(folder: Path) -> Path:
    """Write until the disk is full."""
    ballast = folder / "ballast"
    with ballast.open("wb", buffering=0) as file:
        for size in (1 << 16, 1 << 12, 1):
            block = b"\1" * size
            with pytest.raises(OSError, match="No space left"):
                deque(map(file.write, repeat(block)), maxlen=0)
    return ballast


def test_a_full_disk_is_said_and_waited_out(tmp_path: Path) -> None:
    with (
        mounted(tmp_path / "state", "-t", "tmpfs", "-o", "size=8m", "none") as state,
        running(tmp_path, state) as run,
    ):
        ballast = fill(state)
        run.until_said(FULL + SENTENCE_ENDS)
        run.until_counted(DATABASE_ERRORS)
        run.until_unready("database or disk is full")
        assert run.metric("counterpoint_state_free_bytes") < 1 << 16
        acknowledged = run.done()
        assert 5 <= acknowledged < SHARDS
        ballast.unlink()
        run.until_ready()
        run.until_said(AGAIN)
        run.until(lambda: run.done() > acknowledged, "more shards done")
        run.assert_complete()


def test_a_state_that_cannot_be_written_for_a_while_is_waited_out(tmp_path: Path) -> None:
    with disk_image(tmp_path) as state, running(tmp_path, state) as run:
        files = [str(state / DATABASE_NAME), str(state / f"{DATABASE_NAME}-wal")]
        subprocess.run(["chattr", "+i", *files], check=True)
        try:
            run.until_said(UNWRITABLE + SENTENCE_ENDS)
            run.until_counted(DATABASE_ERRORS)
            run.until_unready("attempt to write a readonly database|disk I/O error")
            acknowledged = run.done()
            assert 5 <= acknowledged < SHARDS
        finally:
            subprocess.run(["chattr", "-i", *files], check=True)
        run.until_ready()
        run.until_said(AGAIN)
        run.until(lambda: run.done() > acknowledged, "more shards done")
        run.assert_complete()


def test_after_an_error_of_the_disk_made_the_state_read_only_a_restart_goes_on(
    tmp_path: Path,
) -> None:
    with disk_image(tmp_path) as state, running(tmp_path, state) as run:
        device = Path(os.path.realpath(_source_of(state))).name
        Path(f"/sys/fs/ext4/{device}/trigger_fs_error").write_text("a test")
        run.until_said(UNWRITABLE + SENTENCE_ENDS)
        run.until_counted(DATABASE_ERRORS)
        run.until_unready("attempt to write a readonly database|disk I/O error")
        run.service.kill()
        subprocess.run(["umount", str(state)], check=True)
        image = str(tmp_path / "disk.img")
        subprocess.run(["mount", "-o", "loop", image, str(state)], check=True)
        run.service.start()
        run.assert_complete()


def test_a_daemon_with_nothing_to_write_finds_out_that_it_could_not(tmp_path: Path) -> None:
    with disk_image(tmp_path) as state, running(tmp_path, state) as run:
        run.until(lambda: run.done() == SHARDS, "every shard done")
        run.until_ready()
        assert run.metric(DATABASE_ERRORS) == 0
        files = [str(state / DATABASE_NAME), str(state / f"{DATABASE_NAME}-wal")]
        subprocess.run(["chattr", "+i", *files], check=True)
        try:
            run.until_unready("attempt to write a readonly database|disk I/O error")
            assert run.done() == SHARDS, "what it knows can be read"
        finally:
            subprocess.run(["chattr", "-i", *files], check=True)
        run.until_ready()
        run.assert_complete()


def test_a_database_that_another_process_locks_is_waited_for(tmp_path: Path) -> None:
    with running(tmp_path, tmp_path / "state") as run:
        with closing(
            sqlite3.connect(run.state / DATABASE_NAME, isolation_level=None, timeout=60)
        ) as other:
            other.execute("BEGIN EXCLUSIVE")
            run.until_said(LOCKED + SENTENCE_ENDS)
            run.until_counted(DATABASE_ERRORS)
            run.until_unready("database is locked")
            acknowledged = run.done()
            assert 5 <= acknowledged < SHARDS
            other.execute("ROLLBACK")
        run.until_said(AGAIN)
        run.until(lambda: run.done() > acknowledged, "more shards done")
        run.assert_complete()


def test_a_clock_that_is_set_back_and_forward_is_said_and_loses_nothing(tmp_path: Path) -> None:
    clock = steered_clock(tmp_path)
    with running(tmp_path, tmp_path / "state", clock.env | {"COUNTERPOINT_LEASE_S": "6"}) as run:
        for step_s, counter in ((-3600, CLOCK_SET_BACK), (0, CLOCK_SET_FORWARD)):
            clock.set(step_s)
            run.kill_miner()  # its lease ends within a term, not within an hour
            run.until_counted(counter)
            assert run.metric(counter) == 1
        back, forward = run.lines("the clock was set: held leases last a full term from now")
        assert "step_s=-3600.0" in back
        assert "step_s=3600.0" in forward
        run.assert_complete()


def test_a_second_service_on_the_same_state_refuses(tmp_path: Path) -> None:
    with running(tmp_path, tmp_path / "state") as run:
        second = _second_service(tmp_path, run)
        assert second.returncode == 75
        assert "a service already holds this state" in second.stderr
        run.assert_complete()


def test_a_damaged_database_says_so_and_is_not_written(tmp_path: Path) -> None:
    with running(tmp_path, tmp_path / "state") as run:
        run.until(lambda: run.done() == SHARDS, "every shard done")
        assert run.service.stop() == 0
        database = run.state / DATABASE_NAME
        database.write_bytes(b"no longer a database".ljust(1 << 16, b"\1"))
        before = database.read_bytes()
        refused = _second_service(tmp_path, run)
        assert refused.returncode == 1
        assert "not a database, or a damaged one" in refused.stderr
        assert str(database) in refused.stderr
        assert database.read_bytes() == before


def _second_service(folder: Path, run: Run) -> subprocess.CompletedProcess[str]:
    at = ["--bucket", str(folder / "logs"), "--state", str(run.state), "--connect", run.endpoint]
    return subprocess.run(
        [sys.executable, "-m", "service.cli.main", "service", *at],
        env=os.environ | {"COUNTERPOINT_HTTP_LISTEN": ""},
        capture_output=True,
        text=True,
        timeout=60,
    )


def _source_of(point: Path) -> str:
    """The device behind a mount."""
    for line in Path("/proc/mounts").read_text().splitlines():
        source, where, *_ = line.split()
        if where == str(point):
            return source
    raise AssertionError(f"nothing is mounted at {point}")
