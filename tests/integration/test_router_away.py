"""A router that is away, at the start and in mid-run: said, measured, waited out, nothing lost."""

import json
import re
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.free_ports import free_endpoint
from tests.integration.daemons import DEADLINE_S, Daemon

pytestmark = pytest.mark.integration


class Watched:
    """A daemon that needs a router, that router, and the daemon's pages."""

    def __init__(self, folder: Path, opened: ExitStack, *arguments: str) -> None:
        self.endpoint = free_endpoint()
        self._http = free_endpoint().removeprefix("tcp/")
        self.router = Daemon(folder, "router", "router", "--listen", self.endpoint)
        variable = f"COUNTERPOINT_{'WORKER_' if arguments[0] == 'worker' else ''}HTTP_LISTEN"
        env = {variable: self._http, "XDG_CACHE_HOME": str(folder / "cache")}
        self.daemon = Daemon(folder, "daemon", *arguments, "--connect", self.endpoint, env=env)
        opened.callback(self.router.end)
        opened.callback(self.daemon.end)

    def page(self, path: str) -> tuple[int, str]:
        """Status and body; 0 and "" while nobody listens."""
        try:
            with urllib.request.urlopen(f"http://{self._http}{path}", timeout=30) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as refused:
            with refused:
                return refused.code, refused.read().decode()
        except urllib.error.URLError:
            return 0, ""

    def metric(self, name: str) -> float:
        found = re.search(rf"^{name} (\S+)$", self.page("/metrics")[1], re.MULTILINE)
        return -1.0 if found is None else float(found[1])

    def until(self, condition: Callable[[], bool], what: str) -> None:
        end_s = time.monotonic() + DEADLINE_S
        while not condition():
            assert self.daemon.is_running(), self.daemon.words()
            assert time.monotonic() < end_s, f"not in time: {what}\n{self.daemon.words()}"
            time.sleep(0.05)

    def until_said(self, words: str, times: int = 1) -> None:
        self.until(lambda: self.daemon.said().count(words) >= times, f"{words!r} said")


@pytest.fixture
def opened() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def service(tmp_path: Path, opened: ExitStack) -> Watched:
    (tmp_path / "logs").mkdir()
    where = ("--bucket", str(tmp_path / "logs"), "--state", str(tmp_path / "state"))
    return Watched(tmp_path, opened, "service", *where)


def test_a_service_waits_for_its_router_and_says_so_on_its_pages(service: Watched) -> None:
    service.daemon.start()
    service.until(lambda: service.page("/readyz")[0] == 503, "pages before there is a router")
    told = json.loads(service.page("/readyz")[1])
    assert told["problems"] == {"router": f"waiting for a router at {service.endpoint}"}
    assert service.page("/healthz") == (200, "alive\n")
    assert service.metric("counterpoint_router_connected") == 0
    assert service.metric("counterpoint_unpublished_events") == 0, "the database is read"
    assert service.page("/rates") == (200, "[]\n")
    service.until_said("waiting for a router")

    service.router.start()
    service.until(lambda: service.page("/readyz")[0] == 200, "a service that is ready")
    assert service.metric("counterpoint_router_connected") == 1
    assert service.daemon.said().count("waiting for a router") == 1

    for times in (1, 2):
        service.router.kill()
        service.until_said("router lost: waiting for it", times)
        service.until(lambda: service.metric("counterpoint_router_connected") == 0, "measured")
        problems = json.loads(service.page("/readyz")[1])["problems"]
        assert set(problems) == {"router"}
        service.router.start()
        service.until_said("router is back", times)
        service.until(lambda: service.page("/readyz")[0] == 200, "a service that is ready again")
        assert service.metric("counterpoint_router_connected") == 1
    assert service.daemon.stop() == 0


def test_a_service_that_waits_for_its_router_stops_in_peace(service: Watched) -> None:
    service.daemon.start()
    service.until_said("waiting for a router")
    assert service.daemon.stop() == 0


def test_workers_wait_for_their_router_and_say_so_on_their_pages(
    tmp_path: Path, opened: ExitStack
) -> None:
    workers = Watched(tmp_path, opened, "worker", "--workers", "1")
    workers.daemon.start()
    workers.until_said("waiting for a router")
    assert workers.page("/healthz") == (200, "ok\n")
    assert workers.page("/readyz") == (503, "no worker is connected to a router\n")
    assert workers.metric("counterpoint_worker_connected") == 0
    assert workers.metric("counterpoint_worker_processes_alive") == 1
    kept = tmp_path / "cache" / "counterpoint"
    assert [each.name.startswith("worker-metrics-") for each in kept.iterdir()] == [True]

    workers.router.start()
    workers.until(lambda: workers.metric("counterpoint_worker_connected") == 1, "a router")
    workers.router.kill()
    workers.until_said("router lost: waiting for it")
    workers.until(lambda: workers.metric("counterpoint_worker_connected") == 0, "measured")
    workers.router.start()
    workers.until_said("router is back")
    workers.until(lambda: workers.metric("counterpoint_worker_connected") == 1, "a router again")
    assert workers.daemon.said().count("waiting for a router") == 1
    assert workers.daemon.stop() == 0
    assert not list(kept.iterdir())
