"""What the database can never take fails alone, at once, and by a sentence; the rest goes on."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from typing import Any

import pytest
from sqlalchemy import Connection, insert, text

from schemas.work import CommitRequest, FailRequest, MiningStats
from service.errors import StatementFailedError
from service.store import commits
from service.store.faults import StoreUnavailableError
from service.store.tables import PIPELINES
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import SCENES_PER_SHARD, World, mined, shard_commit
from tests.contracts.store_contract import StoreContract

NEVER = "the database cannot take this and never will"


def enter(name: str, ordinal: int) -> Callable[[Connection], str]:
    def work(connection: Connection) -> str:
        connection.execute(insert(PIPELINES).values(pipeline_version=name, ordinal=ordinal))
        return name

    return work


def say(statement: str) -> Callable[[Connection], Any]:
    return lambda connection: connection.execute(text(statement))


def say_to_driver(statement: str) -> Callable[[Connection], Any]:
    def work(connection: Connection) -> None:
        connection.connection.cursor().execute(statement)

    return work


NEVER_TAKEN = {
    "syntax": say("SELECT FROM WHERE"),
    "syntax, to the driver": say_to_driver("SELECT 1 IN (SELECT"),
    "no such table": say("SELECT * FROM nothing"),
    "two of one key": lambda c: [enter("p", 1)(c), enter("p", 2)(c)],
    "an integer beyond 64 bits": enter("p", 2**63),
    "a lone surrogate": enter("\ud800", 1),
}


class StatementContract(StoreContract):
    def test_a_shard_without_scenes_is_committed(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        lease = world.mine_lease()
        request = CommitRequest(
            worker_id="w1", lease_id=lease.lease_id, manifest=(), stats=MiningStats()
        )
        assert world.ledger.commit(request, {}).ok
        assert world.ledger.commit(request, {}).ok, "it was stored: a repeat is no error"
        assert world.shards("done") == 1
        assert world.ids() == []
        world.mine_all()
        assert len(world.ids()) == 2 * SCENES_PER_SHARD
        assert world.ledger.settled("p1")

    def test_a_manifest_of_more_scenes_than_a_statement_takes_is_looked_up(
        self, world: World, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(commits, "_SCENES_AT_ONCE", 2)
        world.listed("a")
        world.plan_all()
        assert world.commit_shard(world.mine_lease()).ok
        assert world.commit_shard(world.mine_lease()).ok

    def test_a_scene_beyond_the_first_lookup_is_found_to_be_stored(
        self, world: World, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(commits, "_SCENES_AT_ONCE", 2)
        world.listed("a")
        world.plan_all()
        stored, lease = world.mine_lease(), world.mine_lease()
        assert world.commit_shard(stored).ok
        before = mined(stored.shard)
        records = mined(lease.shard)
        last = dict([list(before.items())[-1]])
        answer = world.ledger.commit(shard_commit(lease, records | last), records | last)
        assert "was stored before, from shard" in answer.problem

    @pytest.mark.parametrize("what", NEVER_TAKEN)
    def test_what_can_never_be_taken_says_so_at_once(self, world: World, what: str) -> None:
        with pytest.raises(StatementFailedError, match=NEVER) as refused:
            world.store.write(NEVER_TAKEN[what])
        assert "\n" not in str(refused.value)
        assert world.ledger.cannot_write == "", "the database is not to blame"
        with pytest.raises(StatementFailedError, match=NEVER), world.store.reading() as connection:
            NEVER_TAKEN["no such table"](connection)
        world.listed("a")
        world.mine_all()
        assert len(world.ids()) == 3 * SCENES_PER_SHARD

    def test_it_fails_alone_among_those_it_shares_a_transaction_with(self, world: World) -> None:
        leading, go_on = Event(), Event()

        def hold_up(connection: Connection) -> str:
            leading.set()
            assert go_on.wait(20)
            return enter("first", 1)(connection)

        with ThreadPoolExecutor(8) as pool:
            first = pool.submit(world.store.write, hold_up)
            assert leading.wait(20)
            good = [pool.submit(world.store.write, enter(f"good-{n}", n)) for n in (2, 3)]
            bad = [
                pool.submit(world.store.write, NEVER_TAKEN[what])
                for what in ("syntax", "an integer beyond 64 bits", "a lone surrogate")
            ]
            while len(world.store._groups._waiting) < len(good) + len(bad):
                assert not first.done()
            go_on.set()
            assert [each.result() for each in (first, *good)] == ["first", "good-2", "good-3"]
            for each in bad:
                with pytest.raises(StatementFailedError, match=NEVER):
                    each.result()

    def test_what_a_worker_says_that_cannot_be_stored_fails_its_question_alone(
        self, world: World
    ) -> None:
        world.listed("a")
        world.plan_all()
        lease = world.mine_lease()
        request = FailRequest.model_construct(
            worker_id="w1",
            lease_id=lease.lease_id,
            error="\ud800",
            permanent=False,
            replaced=False,
            growing=False,
            given_back=False,
        )
        with pytest.raises(StatementFailedError, match=NEVER):
            world.ledger.fail(request)
        assert world.commit_shard(lease).ok


class TestStatementsOnSqlite(OnSqlite, StatementContract):
    pass


@pytest.mark.integration
class TestStatementsOnPostgres(OnPostgres, StatementContract):
    @pytest.mark.parametrize("name", ["a\0b"])
    def test_text_with_a_nul_can_never_be_taken(self, world: World, name: str) -> None:
        with pytest.raises(StatementFailedError, match=NEVER):
            world.store.write(enter(name, 1))

    def test_a_statement_with_too_many_parameters_is_not_a_lost_connection(
        self, world: World
    ) -> None:
        names = [f"p{number}" for number in range(70_000)]
        with pytest.raises(StatementFailedError, match=NEVER), world.store.reading() as connection:
            connection.execute(PIPELINES.select().where(PIPELINES.c.pipeline_version.in_(names)))

    def test_a_lock_that_is_held_and_a_statement_that_takes_too_long_may_pass(
        self, world: World
    ) -> None:
        for setting in ("lock_timeout", "statement_timeout"):
            with world.store.writing() as one:
                one.execute(text("LOCK TABLE pipelines"))
                with pytest.raises(StoreUnavailableError, match="cannot use the database"):
                    self.wait_for_it(world, setting)

    @staticmethod
    def wait_for_it(world: World, setting: str) -> None:
        with world.store.reading() as connection:
            connection.execute(text(f"SET LOCAL {setting} = 100"))
            connection.execute(PIPELINES.select())
