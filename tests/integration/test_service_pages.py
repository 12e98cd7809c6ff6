"""What a running service answers over HTTP, and the rates over the bus."""

import json
import sqlite3
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from schemas.runtime.http_endpoint import HttpEndpoint
from schemas.work import MineLease, PlanLease
from service.cli import main as command
from service.client import ControlClient
from service.curation.rates import RatesRequest
from service.monitoring.http_pages import pages
from tests.contracts.ledger_world import plan_of
from tests.integration.running import ROOT, Running, until

pytestmark = pytest.mark.integration


class Pages:
    """A running service, and its pages."""

    def __init__(self, running: Running, endpoint: HttpEndpoint) -> None:
        self.running, self.endpoint = running, endpoint

    def get(self, path: str) -> tuple[int, str]:
        try:
            with urllib.request.urlopen(self.endpoint.url + path, timeout=30) as answer:  # noqa: S310
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as refused:
            with refused:
                return refused.code, refused.read().decode()

    def problems(self) -> dict[str, str]:
        status, body = self.get("/readyz")
        told = json.loads(body)
        assert told["ready"] == (status == 200) == (not told["problems"])
        problems: dict[str, str] = told["problems"]
        return problems


@contextmanager
def serving(folder: Path) -> Iterator[Pages]:
    running = Running(folder)
    with ExitStack() as opened:
        opened.callback(running.close)
        running.add_log("a")
        running.start_router()
        running.start_service()
        service, ledger = running.service, running.world.ledger
        routes = pages(service, ledger, service.metrics.registry)
        yield Pages(running, opened.enter_context(HttpEndpoint("127.0.0.1:0", routes)))


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Pages]:
    with serving(tmp_path) as found:
        yield found


def mine(running: Running) -> None:
    """Plan and mine the one log, one shard of three scenes; they count as of `bus-7`."""
    world = running.world
    lease = world.claim()
    assert isinstance(lease, PlanLease)
    assert world.commit_plan(lease, plan=plan_of("a", shards=1)).ok
    shard = world.claim()
    assert isinstance(shard, MineLease)
    assert world.commit_shard(shard).ok


def test_the_metrics_tell_of_what_was_mined_listed_and_asked(served: Pages) -> None:
    mine(served.running)
    ControlClient([served.running.endpoint], root=ROOT).top()
    status, page = served.get("/metrics")
    assert status == 200
    lines = page.splitlines()
    assert 'counterpoint_scenes_total{state="scored"} 3.0' in lines
    assert "counterpoint_current_scenes 3.0" in lines
    assert "counterpoint_bucket_objects 1.0" in lines
    assert "counterpoint_bucket_bytes 1.0" in lines
    assert 'counterpoint_recordings{state="done"} 1.0' in lines
    until(
        lambda: (
            'counterpoint_questions_total{outcome="answered",verb="top"} 1.0'
            in served.get("/metrics")[1]
        ),
        "the question counts",
    )


def test_the_page_of_a_running_service_is_clean_for_promtool(served: Pages) -> None:
    mine(served.running)
    page = served.get("/metrics")[1]
    try:
        checked = subprocess.run(
            ["promtool", "check", "metrics"],
            input=page,
            capture_output=True,
            text=True,
            timeout=60,
        )
    except FileNotFoundError:
        pytest.skip("needs promtool, of Debian's package `prometheus`")
    assert (checked.returncode, checked.stdout, checked.stderr) == (0, "", "")


def test_readiness_names_the_router_while_it_is_away(served: Pages) -> None:
    assert served.get("/healthz") == (200, "alive\n")
    assert served.problems() == {}
    served.running.stop_router()
    until(lambda: set(served.problems()) == {"router"}, "the router is missed")
    assert served.get("/healthz")[0] == 200
    served.running.start_router()
    until(lambda: served.problems() == {}, "the router is back")


def test_readiness_names_a_bucket_that_was_not_seen_for_long(
    served: Pages, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs = served.running.logs
    away = logs.rename(logs.with_name("away"))
    until(
        lambda: (
            'counterpoint_bucket_errors_total{kind="unreachable"} 1.0' in served.get("/metrics")[1]
        ),
        "a listing fails",
    )
    assert served.problems() == {}  # a moment of it is nothing yet
    served.running.world.clock.now_s += 3600
    assert served.problems() == {}  # a clock that is set makes no listing older
    watch = served.running.service._watch
    monkeypatch.setattr(watch, "_elapsed_s", lambda: time.monotonic() + 3600)
    assert set(served.problems()) == {"bucket"}
    away.rename(logs)
    until(lambda: served.problems() == {}, "the bucket is back")


def test_readiness_names_a_database_that_does_not_answer(served: Pages) -> None:
    with closing(sqlite3.connect(served.running.world.store.name, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")  # a lock that outlasts the patience of every writer
        until(lambda: set(served.problems()) == {"database"}, "the database is missed")
        assert "counterpoint_database_errors_total 0.0" not in served.get("/metrics")[1]
        other.execute("ROLLBACK")
    until(lambda: served.problems() == {}, "the database is back")


def test_rates_are_flat_rows_for_dashboards(served: Pages) -> None:
    mine(served.running)
    status, body = served.get("/rates?by=vehicle")
    assert status == 200
    (row,) = json.loads(body)
    assert row["group"] == "bus-7"
    assert (row["scenes"], row["disagreement_rate"]) == (3, 0.05)
    assert not any(isinstance(value, dict | list) for value in row.values())
    (hour,) = json.loads(served.get("/rates?since=2023-11-14&until=2023-11-15")[1])
    assert (hour["time"], hour["time_ms"]) == ("2023-11-14T22:00:00Z", 1_699_999_200_000)
    recent = served.get("/rates?since=2023-11-15")
    assert recent == (200, "[]\n")


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("by=scene", "vehicle, version, kind, hour, log"),
        ("since=yesterday", "2026-11-20"),
        ("group=log", "by, since, until"),
    ],
)
def test_rates_refuse_what_cannot_be_meant_in_a_sentence(
    served: Pages, asked: str, said: str
) -> None:
    status, body = served.get(f"/rates?{asked}")
    assert status == 400
    assert said in body


def test_rates_are_the_same_over_the_bus_over_http_and_from_the_state_folder(
    served: Pages, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    running = served.running
    mine(running)
    over_http = json.loads(served.get("/rates?by=log")[1])
    over_bus = ControlClient([running.endpoint], root=ROOT).rates(RatesRequest(by="log"))
    assert [row.model_dump(exclude_none=True) for row in over_bus] == over_http

    def said(*where: str) -> list[Any]:
        capsys.readouterr()  # what the service has logged so far
        assert command.main(["rates", "--by", "log", "--json", *where]) == 0
        return [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    assert said("--state", str(tmp_path / "state")) == over_http
    assert said("--connect", running.endpoint) == over_http
