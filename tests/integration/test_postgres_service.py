"""A real PostgreSQL has one service at a time, wherever it runs and whatever happens to either."""

import json
import re
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from schemas.transport.bus import router_session
from service.api.state_reader import StateReader
from service.cli.main import main
from service.errors import (
    DatabaseTakenError,
    StateInUseError,
    StateUnusableError,
    UsageError,
)
from service.settings.config import load_settings
from service.store.engine import StoreUnavailableError
from service.store.opening import open_ledger_store, open_ledger_store_to_read, sole_service
from service.store.single_writer_lock import SoleService
from tests.contracts.ledger_world import World
from tests.free_ports import free_endpoint
from tests.integration.daemons import Daemon
from tests.integration.postgres_server import Postgres, postgres_server

pytestmark = pytest.mark.integration

DEADLINE_S = 60.0


@pytest.fixture
def postgres() -> Iterator[Postgres]:
    with postgres_server() as server:
        yield server


@pytest.fixture
def endpoint() -> Iterator[str]:
    endpoint = free_endpoint()
    with router_session([endpoint]):
        yield endpoint


def until(condition: Callable[[], bool], words: Callable[[], str]) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s, words()
        time.sleep(0.05)


def service(folder: Path, name: str, url: str, endpoint: str, *, root: str) -> Daemon:
    (folder / "logs").mkdir(exist_ok=True)
    # Roots differ, so that it is the database that keeps two services apart, not the bus.
    at = ("--connect", endpoint, "--bucket", str(folder / "logs"), "--database", url)
    state = ("--state", str(folder / name))
    env = {"COUNTERPOINT_ROOT": root, "COUNTERPOINT_HEARTBEAT_S": "1"}
    return Daemon(folder, name, "service", *at, *state, "--log-format", "json", env=env)


def events(daemon: Daemon) -> list[str]:
    return [json.loads(line)["event"] for line in daemon.said().splitlines()]


def test_a_second_service_is_refused_and_takes_over_when_the_first_is_killed(
    postgres: Postgres, endpoint: str, tmp_path: Path
) -> None:
    first = service(tmp_path, "first", postgres.url, endpoint, root="one")
    second = service(tmp_path, "second", postgres.url, endpoint, root="two")
    try:
        first.start()
        until(lambda: any(e.startswith("serving") for e in events(first)), first.words)
        second.start()
        until(lambda: not second.is_running(), second.words)
        assert re.search(
            rf"a service already holds this database: one at {re.escape(endpoint)} connected from "
            r"127\.0\.0\.1",
            second.said(),
        )
        first.kill()
        second.start()
        until(lambda: any(e.startswith("serving") for e in events(second)), second.words)
        assert second.stop() == 0
    finally:
        first.end()
        second.end()


def test_a_service_outlives_a_restart_of_its_database(
    postgres: Postgres, endpoint: str, tmp_path: Path
) -> None:
    daemon = service(tmp_path, "service", postgres.url, endpoint, root="one")
    try:
        daemon.start()
        until(lambda: any(e.startswith("serving") for e in events(daemon)), daemon.words)
        postgres.stop()
        until(lambda: "trying again" in events(daemon), daemon.words)
        postgres.start()
        until(lambda: "lock on the database taken again" in events(daemon), daemon.words)
        assert "lock on the database lost, taking it again" in events(daemon)
        with pytest.raises(StateInUseError):
            SoleService(postgres.url)
        quiet = events(daemon).count("quiet")
        until(lambda: events(daemon).count("quiet") > quiet, daemon.words)
        assert daemon.stop() == 0
    finally:
        daemon.end()


def test_a_lock_whose_session_ends_unnoticed_is_taken_again(postgres: Postgres) -> None:
    with SoleService(postgres.url) as sole:
        postgres.stop()
        postgres.start()
        sole.announce("tcp/here:7447")
        sole.check()
        with pytest.raises(StateInUseError, match="tcp/here:7447"):
            SoleService(postgres.url)


def test_who_loses_the_database_to_another_ends(postgres: Postgres) -> None:
    with SoleService(postgres.url) as sole:
        sole.check()
        postgres.stop()
        with pytest.raises(StoreUnavailableError, match="cannot use the database"):
            sole.check()
        postgres.start()
        with (
            SoleService(postgres.url, endpoint="tcp/other:7447"),
            pytest.raises(DatabaseTakenError, match=r"one at tcp/other:7447 .*this one ends"),
        ):
            sole.check()
        sole.check()


def test_a_wrong_password_is_a_mistake_at_the_start_and_waited_out_in_mid_run(
    postgres: Postgres,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings = load_settings(database=postgres.url, state=tmp_path)
    with closing(open_ledger_store(settings)) as store, SoleService(postgres.url):
        with store.writing() as connection:
            connection.exec_driver_sql("ALTER ROLE app PASSWORD 'old'")
        postgres.ask_for_passwords()
        for url, said in (
            (postgres.url, "no password supplied"),
            (postgres.url.replace("app@", "app:wrong@"), "password authentication failed"),
            (postgres.url.replace("app@", "nobody:wrong@"), 'failed for user "nobody"'),
            (postgres.url.replace("app@", "app:old@") + "x", 'database "postgresx" does not exist'),
        ):
            monkeypatch.setenv("COUNTERPOINT_DATABASE", url)  # a flag may not have a password
            wrong = load_settings(state=tmp_path)
            for opening in (open_ledger_store, open_ledger_store_to_read, sole_service):
                with pytest.raises(StateUnusableError, match="refuses the login") as refused:
                    opening(wrong)
                assert said in str(refused.value)
            assert main(["top"]) == 1
            told = capsys.readouterr().err
            assert said in told
            assert "wrong@" not in told
            assert told.count("\n") == 1, "one sentence"
        store._engine.dispose()  # as after an outage: it must log in again, and may not
        with pytest.raises(StoreUnavailableError, match="no password supplied"), store.reading():
            pass


def test_a_server_that_may_only_be_read_is_said_until_it_is_written_again(
    postgres: Postgres, tmp_path: Path
) -> None:
    settings = load_settings(database=postgres.url, state=tmp_path)
    with closing(open_ledger_store(settings)) as store:
        world = World.on(store)
        world.listed("a")
        postgres.set("default_transaction_read_only", "on")
        with pytest.raises(StoreUnavailableError, match="read-only transaction"):
            world.listed("a", "b")
        assert world.ledger.last_seq() == 0
        assert "read-only transaction" in world.ledger.cannot_write
        postgres.set("default_transaction_read_only", "off")
        assert "read-only transaction" in world.ledger.cannot_write
        world.ledger.expire()
        assert world.ledger.cannot_write == ""


def test_reading_verbs_read_the_database_beside_a_service(
    postgres: Postgres, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = load_settings(database=postgres.url, state=tmp_path)
    with closing(open_ledger_store(settings)) as store:
        world = World.on(store)
        world.listed("car-7/drive")
        world.mine_all()
    with SoleService(postgres.url):
        assert main(["top", "--database", postgres.url, "--state", str(tmp_path), "--json"]) == 0
        rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        assert len({row["scene_id"] for row in rows}) == len(rows) == 9
        with pytest.raises(UsageError, match="alone may select"):
            StateReader(settings, now_s=0.0).select(budget=3, name=None)
    selection = StateReader(settings, now_s=0.0).select(budget=3, name="week-47")
    assert selection.name == "week-47"
