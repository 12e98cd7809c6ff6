"""A service on a network address is accepted as far as a worker's own settings go."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from schemas.mining import Grid
from schemas.transport.bucket import open_bucket
from schemas.transport.bus import client_session, router_session
from service.app import Service
from service.settings.config import Settings
from service.store.engine import open_store
from tests.contracts.ledger_world import World
from tests.factories import street_log
from tests.free_ports import free_endpoint
from workers.worker import loop as worker_module
from workers.worker.config import Accepted, WorkerConfig, WorkerObserver
from workers.worker.loop import Worker

pytestmark = [pytest.mark.integration, pytest.mark.timeout(600)]

DEADLINE_S = 200.0


def own_address() -> str:
    """Find an address of this machine that is not its loopback."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # of documentation; nothing is sent
        except OSError:
            pytest.skip("this machine has no address but its loopback")
        address: str = probe.getsockname()[0]
    if address.startswith("127."):
        pytest.skip("this machine has no address but its loopback")
    return address


def until(condition: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s, f"not within {DEADLINE_S:g} s: {what}"
        threading.Event().wait(0.02)


class Afar(WorkerObserver):
    """A router on the network, whoever answers there, and a worker that accepts two folders."""

    def __init__(self, folder: Path, opened: ExitStack, *, accepts: Accepted) -> None:
        self.logs, self.overlays = folder / "logs", folder / "overlays"
        (folder / "state").mkdir()
        self.world = World.on(open_store(folder / "state"))
        opened.callback(self.world.store.close)
        self.endpoint = free_endpoint(own_address())
        opened.enter_context(router_session([self.endpoint]))
        self._serving = opened.enter_context(ExitStack())
        self.asked, self.versions = 0, list[str]()
        self._config = WorkerConfig("w1", (self.endpoint,), accepts=accepts)

    def equipped(self, pipeline_version: str) -> None:
        self.versions.append(pipeline_version)

    def serve(self, artifacts: Path) -> None:
        """Answer in the place of whoever answered before."""
        self._serving.close()
        service = Service(
            Settings(
                bucket=str(self.logs),
                artifacts=str(artifacts),
                grid=Grid(shard_s=2.0),
                supervised="recorded",
                list_interval_s=0.1,
                settle_s=0.0,
            ),
            self._serving.enter_context(client_session([self.endpoint])),
            self.world.ledger,
            bucket=open_bucket(str(self.logs)),
        )
        self._serving.enter_context(service)

    def work(self, opened: ExitStack) -> None:
        """Run a worker from now on."""
        stop = threading.Event()
        session = opened.enter_context(client_session([self.endpoint]))
        running = threading.Thread(
            target=Worker(session, self._config, stop=stop, observer=self).run
        )
        running.start()
        opened.callback(running.join)
        opened.callback(stop.set)

    def done(self) -> int:
        return self.world.shards("done")


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Iterator[ExitStack]:
    monkeypatch.setattr(worker_module, "FIRST_REFUSED_S", 0.05, raising=False)
    monkeypatch.setattr(worker_module, "MOST_REFUSED_S", 0.1, raising=False)
    with ExitStack() as stack:
        yield stack


def test_who_names_another_place_is_not_obeyed_until_it_names_ours(
    tmp_path: Path, opened: ExitStack
) -> None:
    accepts = Accepted(bucket=str(tmp_path), artifacts=str(tmp_path / "overlays"))
    street_log(tmp_path / "logs" / "a.mcap", frames=20, style="stands")
    afar = Afar(tmp_path, opened, accepts=accepts)
    rogue = tmp_path / "rogue"
    with capture_logs() as said:
        afar.serve(rogue)
        afar.work(opened)
        until(lambda: afar.versions == [""], "a refusal")
        time.sleep(1.0)  # it is asked ten times more
        refused = [each for each in said if each["event"].startswith("service not accepted")]
        assert len(refused) == 1
        assert f"write overlays to '{rogue}'" in refused[0]["problem"]
        assert "the worker's own setting artifacts = " in refused[0]["problem"]
        assert not rogue.exists()
        assert afar.world.ledger.backlog().leases_held == 0
        afar.serve(tmp_path / "overlays")
        until(lambda: afar.done() == 1, "the log mined for the service that names our place")

        afar.serve(rogue)  # in mid-run
        until(lambda: afar.versions[-1] == "", "a refusal again")
        street_log(tmp_path / "logs" / "b.mcap", frames=20, style="stands")
        until(lambda: len(afar.world.ledger.status().logs) == 2, "the other log listed")
        time.sleep(0.5)
        assert afar.done() == 1
        assert not rogue.exists()
        afar.serve(tmp_path / "overlays")
        until(lambda: afar.done() == 2, "the other log mined")
    assert afar.world.ledger.status().parked == ()
    assert len(list((tmp_path / "overlays").rglob("*.overlay"))) == 2


def test_a_worker_far_from_its_router_with_no_settings_of_its_own_does_nothing(
    tmp_path: Path, opened: ExitStack
) -> None:
    street_log(tmp_path / "logs" / "a.mcap", frames=20, style="stands")
    afar = Afar(tmp_path, opened, accepts=Accepted())
    with capture_logs() as said:
        afar.serve(tmp_path / "overlays")
        afar.work(opened)
        until(lambda: afar.versions == [""], "a refusal")
    (problem,) = [each["problem"] for each in said if "problem" in each]
    assert "own setting bucket is empty" in problem
    assert "COUNTERPOINT_BUCKET" in problem
    assert not (tmp_path / "overlays").exists()
