"""The local pool with real worker processes: killed, stuck, useless, orphaned, told to stop."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from schemas.bucket import open_bucket
from schemas.bus import client_session, free_endpoint, router_session
from schemas.errors import PermanentError
from schemas.keys import DEFAULT_ROOT
from schemas.work import MiningSettings
from service.app import Service
from service.store.engine import open_store
from tests.contracts.ledger_world import World
from workers.pool.local import LocalPool

pytestmark = pytest.mark.integration

DEADLINE_S = 90.0

ORPHANING = """
import sys, threading
from workers.pool.local import LocalPool
if __name__ == "__main__":
    pool = LocalPool(1, connect=["tcp/127.0.0.1:1"], root="none")
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


def test_a_killed_worker_is_replaced_its_death_told_and_the_pool_stops_in_peace() -> None:
    told: list[str] = []
    with LocalPool(
        1, connect=[free_endpoint()], root=DEFAULT_ROOT, on_death=told.append, drain_s=1.0
    ) as pool:
        until(lambda: pool.alive() == 1, "a worker")
        first = pool.pids()[0]
        os.kill(first, signal.SIGKILL)
        until(lambda: pool.alive() == 1 and pool.pids() != [first], "another worker")
        assert told == [f"{pool.prefix}0"]
        second = pool.pids()[0]
        pool.check()
    assert not is_running(second)


def test_workers_die_with_their_pool_even_when_it_is_killed() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", ORPHANING], stdout=subprocess.PIPE, text=True
    ) as pool:
        assert pool.stdout is not None
        worker = int(pool.stdout.readline())
        assert is_running(worker)
        pool.kill()
        pool.wait()
        until(lambda: not is_running(worker), "the end of the orphan")


class Served:
    """A service whose bucket may be anything a worker cannot cope with."""

    def __init__(self, folder: Path, opened: ExitStack, **asked: str) -> None:
        (folder / "logs").mkdir()
        (folder / "state").mkdir()
        (folder / "logs" / "a.mcap").write_bytes(b"x" * 1000)
        self.endpoint = free_endpoint()
        opened.enter_context(router_session([self.endpoint]))
        self.world = World.on(open_store(folder / "state"))
        opened.callback(self.world.store.close)
        settings = MiningSettings.model_validate(
            {"bucket": str(folder / "logs"), "artifacts": str(folder / "overlays")}
            | {"supervised": "recorded"}
            | asked
        )
        service = Service(
            opened.enter_context(client_session([self.endpoint])),
            self.world.ledger,
            bucket=open_bucket(str(folder / "logs")),
            settings=settings,
        )
        opened.enter_context(service)


@pytest.fixture
def opened() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def test_workers_that_cannot_do_what_is_asked_give_up_and_the_pool_says_why(
    tmp_path: Path, opened: ExitStack
) -> None:
    served = Served(tmp_path, opened, supervised="oracle")
    pool = opened.enter_context(LocalPool(1, connect=[served.endpoint], root=DEFAULT_ROOT))

    said: list[str] = []

    def gave_up() -> bool:
        try:
            pool.check()
        except PermanentError as error:
            said.append(str(error))
        return bool(said)

    until(gave_up, "the pool to give up")
    assert "'oracle'" in said[0]
    assert pool.alive() == 0


def test_a_worker_stuck_on_one_lease_is_killed_and_replaced(
    tmp_path: Path, opened: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    hole = opened.enter_context(socket.create_server(("127.0.0.1", 0)))  # accepts, never answers
    for name, value in {
        "AWS_ENDPOINT": f"http://127.0.0.1:{hole.getsockname()[1]}",
        "AWS_ACCESS_KEY_ID": "id",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_REGION": "nowhere",
    }.items():
        monkeypatch.setenv(name, value)
    served = Served(tmp_path, opened, bucket="s3://hole")
    told: list[str] = []
    pool = opened.enter_context(
        LocalPool(
            1,
            connect=[served.endpoint],
            root=DEFAULT_ROOT,
            lease_deadline_s=2.0,
            drain_s=0.5,
            on_death=told.append,
        )
    )
    until(lambda: bool(told), "the death of the stuck worker")
    assert told == [f"{pool.prefix}0"]
    assert served.world.ledger.worker_died(told[0]) == 1, "its lease is taken back at once"
