"""A standby takes over from a service that dies, freezes or loses its database, without loss."""

import signal
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import Connection, text

from service.errors import DatabaseTakenError, StateUnusableError
from service.settings.config import load_settings
from service.store.opening import ELSEWHERE, open_ledger_store
from tests.contracts.ledger_world import World
from tests.integration.cutting_proxy import CuttingProxy
from tests.integration.postgres_server import Postgres, postgres_server
from tests.integration.standby_pair import Pair

pytestmark = [pytest.mark.integration, pytest.mark.timeout(400)]

SERVICES = ("first", "second")
FAILOVER_S = 15.0
"""Longest time from a loss to the first commit after it, seconds."""


@pytest.fixture
def postgres() -> Iterator[Postgres]:
    with postgres_server() as server:
        yield server


def test_a_killed_and_a_frozen_service_are_followed_by_the_standby_without_loss(
    postgres: Postgres, tmp_path: Path
) -> None:
    databases = dict.fromkeys(SERVICES, postgres.url)
    pair = Pair(tmp_path, databases=databases, logs=14, miners=2, record_s=0.05)
    try:
        pair.start("router-0", "first", "miner-0", "miner-1")
        pair.until_done(1)
        pair.start("second")
        _until_standing_by(pair, "second")
        acknowledged = pair.done()
        pair.send("first", signal.SIGKILL)
        killed_s = pair.until_done(acknowledged + 3)
        assert pair.serving(SERVICES) == ["second"]

        pair.start("first")
        _until_standing_by(pair, "first")
        acknowledged = pair.done()
        pair.send("second", signal.SIGSTOP)
        frozen_s = pair.until_done(acknowledged + 3)
        pair.send("second", signal.SIGCONT)
        _until_withdrawn(pair, "second")
        assert pair.serving(SERVICES) == ["first"]
        pair.until_done(pair.shards)
        sys.stdout.write(f"commits after a kill {killed_s:.1f} s, a freeze {frozen_s:.1f} s\n")
        assert pair.scenes() == pair.expected()
        assert pair.client.status().parked == ()
        assert max(killed_s, frozen_s) < FAILOVER_S
    finally:
        pair.end()


def test_a_service_that_is_cut_off_from_its_database_withdraws_and_is_followed(
    postgres: Postgres, tmp_path: Path
) -> None:
    with CuttingProxy(postgres.port) as network:
        behind = postgres.url.replace(f":{postgres.port}/", f":{network.port}/")
        databases = {"first": behind, "second": postgres.url}
        pair = Pair(tmp_path, databases=databases, logs=10, miners=2, record_s=0.05)
        try:
            pair.start("router-0", "first", "miner-0", "miner-1")
            pair.until_done(1)
            pair.start("second")
            _until_standing_by(pair, "second")
            acknowledged = pair.done()
            network.cut()
            cut_s = pair.until_done(acknowledged + 3)
            _until_withdrawn(pair, "first")
            network.heal()
            _until_standing_by(pair, "first")
            pair.until_done(pair.shards)
            sys.stdout.write(f"commits after a cut {cut_s:.1f} s\n")
            assert pair.scenes() == pair.expected()
            assert cut_s < FAILOVER_S
        finally:
            pair.end()


def _until_standing_by(pair: Pair, name: str) -> None:
    _until_said(pair, name, "standing by: another service is active")


def _until_withdrawn(pair: Pair, name: str) -> None:
    _until_said(pair, name, "withdrawn, standing by")


def _until_said(pair: Pair, name: str, words: str) -> None:
    for _ in range(1200):
        if words in "\n".join(pair.said(name).splitlines()[-30:]):
            return
        time.sleep(0.05)
    pytest.fail(pair.words())


def test_a_state_folder_of_a_postgresql_begins_no_empty_ledger_without_it(
    postgres: Postgres, tmp_path: Path
) -> None:
    open_ledger_store(load_settings(database=postgres.url, state=tmp_path)).close()
    alone = load_settings(state=tmp_path)
    with pytest.raises(StateUnusableError, match=r"is the PostgreSQL postgresql.*no database is s"):
        open_ledger_store(alone)
    assert not list(tmp_path.glob("*.sqlite*"))
    (tmp_path / ELSEWHERE).unlink()
    open_ledger_store(alone).close()
    open_ledger_store(load_settings(database=postgres.url, state=tmp_path)).close()
    open_ledger_store(alone).close()  # it has a ledger of its own


def test_a_store_of_an_earlier_term_may_neither_write_nor_read(
    postgres: Postgres, tmp_path: Path
) -> None:
    settings = load_settings(database=postgres.url, state=tmp_path)
    with closing(open_ledger_store(settings)) as frozen:
        world = World.on(frozen)
        world.listed("a")
        with closing(open_ledger_store(settings)) as active:
            assert active.term == frozen.term + 1
            with pytest.raises(DatabaseTakenError, match="another service serves this database"):
                world.listed("a", "b")
            with pytest.raises(DatabaseTakenError), frozen.reading():
                pass
            assert World.on(active).ids() == []
            with active.reading() as connection:
                logs = connection.execute(text("SELECT count(*) FROM recordings")).scalar_one()
            assert logs == 1, "what the frozen one wrote before is kept, what it wrote after is not"


def test_a_transaction_that_is_open_at_a_takeover_is_undone(
    postgres: Postgres, tmp_path: Path
) -> None:
    settings = load_settings(database=postgres.url, state=tmp_path)
    with closing(open_ledger_store(settings)) as frozen:

        def write(connection: Connection) -> None:
            connection.execute(text("INSERT INTO counters (name, value) VALUES ('late', 1)"))
            open_ledger_store(settings).close()

        with pytest.raises(DatabaseTakenError):
            frozen.write(write)
        with closing(open_ledger_store(settings)) as active, active.reading() as connection:
            late = text("SELECT count(*) FROM counters WHERE name = 'late'")
            assert connection.execute(late).scalar_one() == 0
