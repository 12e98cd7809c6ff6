"""How many stretches of the current logs cannot be read, as any database counts them."""

import pytest

from schemas.work import Damage, LogPlan, MineLease, Recording
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World, mined, plan_of, recording, shard_commit
from tests.contracts.store_contract import StoreContract


def at(offset: int, what: str = "CRC differs") -> Damage:
    return Damage(key="part.mcap", offset=offset, bytes=8, what=what)


class DamagedStretchesContract(StoreContract):
    def test_each_counts_once_for_as_long_as_it_lies_there(self, world: World) -> None:
        def planner(of: Recording) -> LogPlan:
            found = (at(4), at(4), at(90)) if of.parts[0].etag.endswith("-a") else ()
            noticed = Damage(key="part.mcap", offset=1, bytes=0, what="no class")
            return plan_of(of.log_id, shards=2).model_copy(update={"damage": (noticed, *found)})

        def mine(version: str) -> None:
            while isinstance(lease := world.claim(version=version), MineLease):
                records = mined(lease.shard, pipeline_version=version)
                found = (at(4, "cut off"), at(200 + lease.shard.index))
                request = shard_commit(lease, records).model_copy(update={"damage": found})
                assert world.ledger.commit(request, records).ok

        def count() -> int:
            return world.ledger.backlog().damaged_stretches

        world.planner = planner
        world.listed("x", "y")
        assert count() == 0
        world.plan_all()
        assert count() == 2 * 2, "of two logs, what planning met"
        mine("p1")
        assert count() == 2 * 4, "each shard met one more, and one that was known"
        world.register_pipeline("p2")
        assert count() == 2 * 4, "a new version forgets nothing"
        world.plan_all("p2")
        mine("p2")
        assert count() == 2 * 4, "and finds no news"
        world.ledger.sync_recordings([recording("x", etag="b"), recording("y", etag="a")])
        assert count() == 4, "a replaced log is another"
        world.ledger.sync_recordings([])
        assert count() == 0


class TestDamagedStretchesOnSqlite(OnSqlite, DamagedStretchesContract):
    pass


@pytest.mark.integration
class TestDamagedStretchesOnPostgres(OnPostgres, DamagedStretchesContract):
    pass
