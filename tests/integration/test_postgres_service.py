"""A real PostgreSQL has one service at a time, wherever it runs and whatever happens to either."""

import json
import os
import re
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import create_engine, text

from schemas.transport.bus import router_session
from service.api.state_reader import StateReader
from service.cli.main import main
from service.errors import StateInUseError, StateUnusableError, UsageError
from service.settings.config import load_settings
from service.store.engine import StoreUnavailableError
from service.store.opening import open_ledger_store, open_ledger_store_to_read, sole_service
from service.store.single_writer_lock import DatabaseTakenError, SoleService
from tests.contracts.ledger_world import World
from tests.free_ports import free_endpoint
from tests.integration.daemons import Daemon

pytestmark = pytest.mark.integration

DEADLINE_S = 60.0


class Postgres:
    """A server of the test's own, which can be restarted."""

    def __init__(self, folder: Path) -> None:
        pytest.importorskip("psycopg", reason="needs the extra `postgres`")
        programs = sorted(Path("/usr/lib/postgresql").glob("*/bin"))
        if not programs:
            pytest.skip("needs Debian's package `postgresql`")
        self._bin, self._folder = programs[-1], folder
        self._as: tuple[str, ...] = ()
        if os.geteuid() == 0:  # PostgreSQL refuses to run as root
            shutil.chown(folder, "postgres", "postgres")
            self._as = ("setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups")
        with socket.create_server(("127.0.0.1", 0)) as probe:
            self.port = probe.getsockname()[1]
        self.url = f"postgresql+psycopg://app@127.0.0.1:{self.port}/postgres"
        self._do("initdb", "-D", self._data, "-U", "app", "--auth=trust", "-E", "UTF8", "--no-sync")

    @property
    def _data(self) -> str:
        return str(self._folder / "data")

    def start(self) -> None:
        options = f"-h 127.0.0.1 -p {self.port} -k {self._folder}"
        log = str(self._folder / "log")
        self._do("pg_ctl", "-D", self._data, "-w", "-l", log, "-o", options, "start")

    def stop(self) -> None:
        self._do("pg_ctl", "-D", self._data, "-w", "-m", "immediate", "stop")

    def ask_for_passwords(self) -> None:
        """Trust nobody any more who logs in from now on."""
        hba = Path(self._data) / "pg_hba.conf"
        hba.write_text("host all all 127.0.0.1/32 scram-sha-256\n")
        self._do("pg_ctl", "-D", self._data, "reload")

    def set(self, name: str, value: str) -> None:
        """Change a setting for every session, from its next transaction on."""
        with (Path(self._data) / "postgresql.auto.conf").open("a") as file:
            file.write(f"{name} = {value}\n")
        self._do("pg_ctl", "-D", self._data, "reload")
        engine = create_engine(self.url)
        shown = text(f"SHOW {name}")

        def is_known() -> bool:
            with engine.connect() as connection:
                return bool(connection.execute(shown).scalar_one() == value)

        until(is_known, lambda: f"{name} is not {value}")
        engine.dispose()

    def _do(self, program: str, *arguments: str) -> None:
        subprocess.run(
            [*self._as, str(self._bin / program), *arguments],
            check=True,
            timeout=60,
            cwd=self._folder,
            stdout=subprocess.DEVNULL,
        )


@pytest.fixture
def postgres() -> Iterator[Postgres]:
    folder = Path(tempfile.mkdtemp(prefix="postgres-"))
    try:
        server = Postgres(folder)
        server.start()
        yield server
        server.stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


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
    postgres: Postgres, tmp_path: Path, capsys: pytest.CaptureFixture[str]
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
            wrong = load_settings(database=url, state=tmp_path)
            for opening in (open_ledger_store, open_ledger_store_to_read, sole_service):
                with pytest.raises(StateUnusableError, match="refuses the login") as refused:
                    opening(wrong)
                assert said in str(refused.value)
            assert main(["top", "--database", url]) == 1
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
