"""The local pool with real worker processes: killed, stuck, useless, orphaned, told to stop."""

import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from schemas.errors import PermanentError, TransientError
from schemas.runtime.http_endpoint import HttpEndpoint
from schemas.transport.bucket import open_bucket
from schemas.transport.bus import client_session, router_session
from schemas.transport.keys import DEFAULT_ROOT
from service.app import Service
from service.settings.config import Settings
from service.store.engine import open_store
from tests.contracts.ledger_world import World
from tests.free_ports import free_endpoint
from workers.pool.local import LocalPool
from workers.pool.pages import pool_pages
from workers.version import version_of

pytestmark = pytest.mark.integration

DEADLINE_S = 240.0

ORPHANING = """
import sys, threading
from pathlib import Path
from workers.pool.local import LocalPool
if __name__ == "__main__":
    pool = LocalPool(1, connect=["tcp/127.0.0.1:1"], root="none", home=Path(sys.argv[1]))
    pool.start()
    while not pool.pids():
        threading.Event().wait(0.01)
    sys.stdout.write(f"{pool.pids()[0]}\\n")
    sys.stdout.flush()
    threading.Event().wait()
"""


def until(condition: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s, f"not within {DEADLINE_S:g} s: {what}"
        threading.Event().wait(0.05)


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_killed_worker_is_replaced_its_death_told_and_the_pool_stops_in_peace(
    tmp_path: Path,
) -> None:
    told: list[str] = []
    with LocalPool(
        1,
        connect=[free_endpoint()],
        root=DEFAULT_ROOT,
        home=tmp_path,
        on_death=told.append,
        drain_s=1.0,
    ) as pool:
        until(lambda: pool.alive() == 1, "a worker")
        first = pool.pids()[0]
        os.kill(first, signal.SIGKILL)
        until(lambda: pool.alive() == 1 and pool.pids() != [first], "another worker")
        assert told == [f"{pool.prefix}0"]
        second = pool.pids()[0]
        pool.check()
    assert not is_running(second)
    assert not list(tmp_path.iterdir())


def test_workers_are_replaced_and_counted_although_the_folder_of_metrics_is_taken_away(
    tmp_path: Path, opened: ExitStack
) -> None:
    served = Served(tmp_path, opened)
    with capture_logs() as said:
        pool = opened.enter_context(pool_of(served))
        until(lambda: counted(pool, "plans_total", outcome="refused") == 1, "a plan")
        (folder,) = served.home.iterdir()
        shutil.rmtree(folder)
        (first,) = pool.pids()
        os.kill(first, signal.SIGKILL)
        until(lambda: pool.alive() == 1 and pool.pids() != [first], "another worker")
        pool.check()
        (served.logs / "b.mcap").write_bytes(b"y" * 1000)
        until(lambda: counted(pool, "plans_total", outcome="refused") == 1, "a plan that counts")
        shutil.rmtree(folder)
        until(lambda: len(list(folder.glob("*.db"))) > 0, "files made again without a death")
        until(lambda: sum("were removed" in each["event"] for each in said) > 1, "said again")
    removed = [each for each in said if "were removed" in each["event"]]
    assert [each["folder"] for each in removed] == [str(folder)] * 2
    assert counted(pool, "restarts_total", cause="crashed") == 1


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_pool_whose_watching_ends_by_a_bug_says_so_wherever_it_is_asked(
    tmp_path: Path, opened: ExitStack
) -> None:
    def bug(_worker_id: str) -> None:
        raise LookupError("of all things")

    pool = LocalPool(
        1,
        connect=[free_endpoint()],
        root=DEFAULT_ROOT,
        home=tmp_path,
        on_death=bug,
        drain_s=1.0,
    )
    url = opened.enter_context(HttpEndpoint("127.0.0.1:0", pool_pages(pool))).url
    opened.enter_context(pool)
    until(lambda: pool.alive() == 1, "a worker")
    pool.check()
    os.kill(pool.pids()[0], signal.SIGKILL)
    until(lambda: get(f"{url}/healthz")[0] == 503, "a page that tells")
    sentence = "the pool watches its workers no more: LookupError('of all things')"
    assert get(f"{url}/healthz") == (503, f"{sentence}\n")
    assert get(f"{url}/readyz") == (503, f"{sentence}\n")
    with pytest.raises(TransientError, match="no more: LookupError"):
        pool.check()


def test_a_worker_that_cannot_be_started_now_is_started_later(
    tmp_path: Path, opened: ExitStack
) -> None:
    pool = LocalPool(1, connect=[free_endpoint()], root=DEFAULT_ROOT, home=tmp_path, drain_s=1.0)
    with capture_logs() as said, no_free_handles():
        opened.enter_context(pool)
        until(lambda: len(said) >= 2, "two attempts")
        assert pool.alive() == 0
        pool.check()
    assert {each["event"] for each in said} == {"worker cannot be started"}
    assert {each["problem"] for each in said} == {"Too many open files"}
    until(lambda: pool.alive() == 1, "a worker")


@contextmanager
def no_free_handles() -> Iterator[None]:
    """Let this process open nothing more."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    opened = len(list(Path("/proc/self/fd").iterdir()))
    resource.setrlimit(resource.RLIMIT_NOFILE, (opened + 5, before[1]))
    hogs: list[int] = []
    try:
        with pytest.raises(OSError, match="Too many open files"):
            hogs.extend(os.open(os.devnull, os.O_RDONLY) for _ in range(opened + 5))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
        for hog in hogs:
            os.close(hog)


def test_workers_die_with_their_pool_even_when_it_is_killed_and_leave_no_files(
    tmp_path: Path,
) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", ORPHANING, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as pool:
        assert pool.stdout is not None
        worker = int(pool.stdout.readline())
        assert is_running(worker)
        assert list(tmp_path.glob("worker-metrics-*"))
        pool.kill()
        pool.wait()
        until(lambda: not is_running(worker), "the end of the orphan")
    assert not list(tmp_path.iterdir())


class Served:
    """A service whose bucket may be anything a worker cannot cope with."""

    def __init__(self, folder: Path, opened: ExitStack, **asked: str) -> None:
        self.logs, self.home = folder / "logs", folder / "home"
        self.logs.mkdir()
        (folder / "state").mkdir()
        (self.logs / "a.mcap").write_bytes(b"x" * 1000)
        self.endpoint = free_endpoint()
        opened.enter_context(router_session([self.endpoint]))
        self.world = World.on(open_store(folder / "state"))
        opened.callback(self.world.store.close)
        self._serving = opened.enter_context(ExitStack())
        self.serve(**asked)

    def serve(self, **asked: str) -> None:
        """Start the service, with other settings than before, in the place of the one before."""
        self._serving.close()
        self.settings = Settings.model_validate(
            {"bucket": str(self.logs), "artifacts": str(self.logs.parent / "overlays")}
            | {"supervised": "recorded", "list_interval_s": 0.2, "settle_s": 0.0}
            | asked
        )
        service = Service(
            self.settings,
            self._serving.enter_context(client_session([self.endpoint])),
            self.world.ledger,
            bucket=open_bucket(str(self.logs)),
        )
        self._serving.enter_context(service)


def pool_of(served: Served, *, drain_s: float = 1.0, **how: Any) -> LocalPool:
    """Make a pool of one worker for a service."""
    return LocalPool(
        1,
        connect=[served.endpoint],
        root=DEFAULT_ROOT,
        home=served.home,
        drain_s=drain_s,
        **how,
    )


@pytest.fixture
def opened() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def test_workers_that_cannot_do_what_is_asked_give_up_and_the_pool_says_why(
    tmp_path: Path, opened: ExitStack
) -> None:
    served = Served(tmp_path, opened, selfsupervised="paper")  # its weights do not ship
    pool = opened.enter_context(pool_of(served))

    said: list[str] = []

    def gave_up() -> bool:
        try:
            pool.check()
        except PermanentError as error:
            said.append(str(error))
        return bool(said)

    until(gave_up, "the pool to give up")
    assert "paper needs weights that do not ship" in said[0]
    assert pool.alive() == 0


def test_a_pool_that_was_at_work_waits_for_a_mistake_of_the_service_to_be_mended(
    tmp_path: Path, opened: ExitStack
) -> None:
    served = Served(tmp_path, opened)
    pool = opened.enter_context(pool_of(served))
    until(lambda: counted(pool, "plans_total", outcome="refused") == 1, "a plan")
    served.serve(selfsupervised="paper")
    until(lambda: counted(pool, "restarts_total", cause="unready") >= 1, "a worker that gives up")
    pool.check()
    served.serve()
    (served.logs / "b.mcap").write_bytes(b"y" * 1000)
    until(lambda: counted(pool, "plans_total", outcome="refused") >= 2, "work that goes on")


def dig_hole(opened: ExitStack, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `s3://hole` be a store that accepts every connection and never answers."""
    hole = opened.enter_context(socket.create_server(("127.0.0.1", 0)))
    for name, value in {
        "AWS_ENDPOINT": f"http://127.0.0.1:{hole.getsockname()[1]}",
        "AWS_ACCESS_KEY_ID": "id",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_REGION": "nowhere",
    }.items():
        monkeypatch.setenv(name, value)


def counted(pool: LocalPool, name: str, **labels: str) -> float:
    value = pool.registry.get_sample_value(f"counterpoint_worker_{name}", labels)
    return -1.0 if value is None else value


def test_a_worker_stuck_on_one_lease_is_killed_and_replaced(
    tmp_path: Path, opened: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    dig_hole(opened, monkeypatch)
    served = Served(tmp_path, opened, bucket="s3://hole")
    told: list[str] = []
    pool = opened.enter_context(
        pool_of(served, lease_deadline_s=2.0, drain_s=0.5, on_death=told.append)
    )
    until(lambda: bool(told), "the death of the stuck worker")
    assert told == [f"{pool.prefix}0"]
    assert counted(pool, "restarts_total", cause="stuck") == 1
    assert served.world.ledger.worker_died(told[0]) == 1, "its lease is taken back at once"


def test_a_place_whose_workers_die_in_each_lease_is_filled_later_each_time_and_says_so(
    tmp_path: Path, opened: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    dig_hole(opened, monkeypatch)
    served = Served(tmp_path, opened, bucket="s3://hole")
    with capture_logs() as said:
        pool = opened.enter_context(
            pool_of(served, on_death=lambda worker_id: served.world.ledger.worker_died(worker_id))
        )
        for deaths in range(1, 4):
            served.world.clock.now_s += 100.0  # the plan has rested
            until(lambda: served.world.ledger.backlog().leases_held == 1, "a lease")
            until(lambda: len(pool.pids()) == 1, "a worker")
            os.kill(pool.pids()[0], signal.SIGKILL)
            until(lambda: served.world.ledger.backlog().leases_held == 0, "its lease taken back")
            assert counted(pool, "restarts_total", cause="crashed") == deaths
    rests = [each["restart_s"] for each in said if each["event"] == "worker died"]
    assert rests[2] >= 1.0 > 0.5 >= rests[0]
    (line,) = [each for each in said if each["event"].startswith("every worker here dies")]
    assert (line["deaths"], line["worker_id"]) == (3, f"{pool.prefix}0")
    assert served.world.ledger.status().parked == ()


def test_signals_that_come_twice_do_not_cut_a_workers_drain_short(
    tmp_path: Path, opened: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    dig_hole(opened, monkeypatch)
    served = Served(tmp_path, opened, bucket="s3://hole")
    pool = opened.enter_context(pool_of(served, drain_s=5.0))
    until(lambda: counted(pool, "busy") == 1, "a worker with a lease")
    (worker,) = pool.pids()
    os.kill(worker, signal.SIGTERM)
    os.kill(worker, signal.SIGINT)
    os.kill(worker, signal.SIGTERM)
    until(lambda: worker not in pool.pids(), "the end of the worker")
    until(lambda: counted(pool, "restarts_total", cause="stopped") == 1, "an end in peace")
    assert counted(pool, "plans_total", outcome="given_back") == 1
    assert counted(pool, "restarts_total", cause="crashed") == 0


def test_a_pool_serves_what_its_workers_count_and_the_counts_survive_them(
    tmp_path: Path, opened: ExitStack
) -> None:
    served = Served(tmp_path, opened)
    pool = pool_of(served)
    url = opened.enter_context(HttpEndpoint("127.0.0.1:0", pool_pages(pool))).url
    assert get(f"{url}/healthz") == (503, "the pool watches its workers no more: it is stopped\n")
    assert pool.pipeline_version() == ""
    opened.enter_context(pool)
    assert get(f"{url}/healthz") == (200, "ok\n")
    until(lambda: get(f"{url}/readyz") == (200, "ok\n"), "a pool that is ready")
    assert pool.pipeline_version() == version_of(served.settings.mining())
    until(lambda: counted(pool, "plans_total", outcome="refused") == 1, "a plan")
    assert counted(pool, "connected") == 1

    (first,) = pool.pids()
    os.kill(first, signal.SIGKILL)
    until(lambda: counted(pool, "restarts_total", cause="crashed") == 1, "a death")
    assert get(f"{url}/readyz")[0] == 503
    until(lambda: get(f"{url}/readyz")[0] == 200, "a pool that is ready again")
    (served.logs / "b.mcap").write_bytes(b"y" * 1000)
    until(lambda: counted(pool, "plans_total", outcome="refused") == 2, "another plan")
    page = get(f"{url}/metrics")[1]
    assert 'counterpoint_worker_plans_total{outcome="refused"} 2.0' in page
    assert "counterpoint_worker_processes_alive 1.0" in page


def get(url: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(url, timeout=30) as answer:  # noqa: S310
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()
