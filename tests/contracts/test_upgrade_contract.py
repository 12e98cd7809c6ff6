"""A state of the first schema is brought up to date with everything that lies in it."""

import json
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import Engine, insert, select

from schemas.work import Part, Recording
from service.curation.listing import ScenesRequest
from service.errors import StateUnusableError
from service.store import migrations
from service.store.engine import Store, open_store_to_read
from service.store.tables import (
    LISTED_SCENES,
    LISTED_TRACKS,
    LISTED_WORDS,
    LISTING_THINGS,
    METADATA,
    SCHEMA_VERSIONS,
)
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import Clock, World
from tests.contracts.test_listing_contract import commit, judge, scene
from tests.factories import track_at

FIRST = json.loads(Path(__file__).with_name("state_v1.json").read_text(encoding="utf-8"))
"""Rows by table as the first schema's program wrote them: logs and shards in every state that one
service can leave, two pipeline versions, a replaced and a deleted log, selections."""


TO_VERSION_16 = (
    "DROP INDEX listed_by_score",
    "DROP INDEX listed_by_time",
    "ALTER TABLE listed_scenes DROP COLUMN near_ranges",
    "ALTER TABLE listed_scenes DROP COLUMN far_ranges",
    "DROP TABLE listed_tracks",
    "DROP TABLE listing_things",
    "DELETE FROM schema_version WHERE version > 16",
)


def of_old(log_id: str, etag: str) -> Recording:
    """A recording as the first program's bucket had it."""
    return Recording(log_id=log_id, parts=(Part(key=f"{log_id}.mcap", size=100, etag=etag),))


def stored(row: dict[str, Any]) -> dict[str, Any]:
    """A row as the database gives it: records are bytes."""
    return row | {"record": row["record"].encode()} if "record" in row else row


class UpgradeContract(ABC):
    """Every promise, tested on what `make_store` opens; it must open the same database again."""

    @abstractmethod
    def make_store(self) -> Store:
        """Open the test's database, empty at first."""

    @abstractmethod
    def make_engine(self) -> Engine:
        """Make an engine on the same database."""

    @pytest.fixture(autouse=True)
    def _first(self, database: None, monkeypatch: pytest.MonkeyPatch) -> None:
        with monkeypatch.context() as before:
            before.setattr(migrations, "STEPS", migrations.STEPS[:1])
            before.setattr(migrations, "SCHEMA_VERSION", 1)
            engine = self.make_engine()  # as the first program: it knew nothing of today's tables
            with engine.begin() as connection:
                migrations.migrate(connection, name="the first")
                for name, rows in FIRST["tables"].items():
                    table = METADATA.tables[name]
                    connection.execute(table.delete())  # counters begin with rows of their own
                    connection.execute(insert(table), [stored(row) for row in rows])
            engine.dispose()

    @pytest.fixture
    def world(self) -> Iterator[World]:
        clock = Clock()
        clock.now_s = FIRST["now_s"]
        store = self.make_store()
        yield World.on(store, clock=clock, settle_s=30.0)
        store.close()

    def test_every_row_is_found_again(self, world: World) -> None:
        with world.store.reading() as connection:
            versions = connection.execute(select(SCHEMA_VERSIONS.c.version)).scalars().all()
            assert sorted(versions) == list(range(1, migrations.SCHEMA_VERSION + 1))
            for name, rows in FIRST["tables"].items():
                table = METADATA.tables[name]
                known = [table.c[column] for column in rows[0]]
                found = connection.execute(select(*known).order_by(*table.primary_key.columns))
                key = [column.name for column in table.primary_key.columns]
                expected = sorted(rows, key=lambda row: [row[column] for column in key])
                kept = [dict(row._mapping) for row in found]
                if name == "counters":  # later versions count more
                    kept = [row for row in kept if row["name"] in {one["name"] for one in rows}]
                assert kept == [stored(row) for row in expected]

    def test_states_and_scenes_and_selections_are_what_they_were(self, world: World) -> None:
        status = world.ledger.status("p2")
        assert {log.log_id: log.state for log in status.logs} == {
            "a-done": "mining",
            "b-replaced": "mining",
            "d-refused": "refused",
            "e-parked": "parked",
            "f-waiting": "waiting",
            "g-leased": "planning",
            "h-stale": "stale",
            "i-resting": "waiting",
        }
        assert [log.log_id for log in status.logs if log.truncated_parts] == ["a-done"]
        assert world.ledger.backlog().damaged == {"truncated": 1, "unreadable": 1}
        assert status.shards_by_state == {"done": 2, "leased": 1, "parked": 1, "ready": 2}
        assert len(status.parked) == 2
        kept = [row for row in FIRST["tables"]["scenes"] if row["is_current"]]
        assert sorted(world.ids()) == sorted(row["scene_id"] for row in kept)
        assert [each.name for each in world.ledger.selections.all()] == ["monday", "selection-2"]
        with world.store.reading() as connection:
            listed = select(LISTED_SCENES.c.seq).order_by(LISTED_SCENES.c.seq)
            assert list(connection.execute(listed).scalars()) == sorted(row["seq"] for row in kept)
        assert {each.strategy for each in world.ledger.selections.listed()} == {""}

    def test_a_listing_without_ranges_is_filled_again(self, world: World) -> None:
        tracks = (track_at(12.4), track_at(70.0))
        commit(world, *(scene(n, n / 10, tracks=tracks[: 1 + n % 2]) for n in range(6)))
        judged = world.ledger.listing(ScenesRequest(most=1)).rows[0].scene_id
        judge(world, judged)
        before = self._listing(world.store)
        assert [len(rows) for rows in before] == [6, 6, 6, 1]
        assert {row.far_ranges for row in before[0]} == {0, 1 << 69 - 63}
        world.store.close()
        engine = self.make_engine()
        with engine.begin() as connection:  # as the program of version 16 left it
            for step in TO_VERSION_16:
                connection.exec_driver_sql(step)
        engine.dispose()
        store = self.make_store()
        assert self._listing(store) == before
        again = World.on(store)
        for asked in (ScenesRequest(beyond_m=60), ScenesRequest(beyond_m=60, class_name="car")):
            assert again.ledger.listing(asked).total == 3
        assert again.ledger.listing(ScenesRequest(judged="yes")).rows[0].scene_id == judged
        store.close()

    @staticmethod
    def _listing(store: Store) -> list[Sequence[Any]]:
        with store.reading() as connection:
            return [
                connection.execute(select(table).order_by(*table.primary_key.columns)).all()
                for table in (LISTED_SCENES, LISTED_WORDS, LISTED_TRACKS, LISTING_THINGS)
            ]

    def test_work_goes_on_and_old_revisions_come_back(self, world: World) -> None:
        world.ledger.resume()
        world.clock.now_s += 3600
        world.ledger.expire()
        world.clock.now_s += 60  # work whose worker has died rests
        recordings = [
            json.loads(row["recording"])
            for row in FIRST["tables"]["recordings"]
            if row["is_current"]
        ]
        assert len(recordings) == 8
        lease = world.plan_lease("w1", "p2")
        assert lease.settled  # listed when nobody noted when: long ago
        assert world.commit_plan(lease).ok
        world.mine_all("p2")
        done = {"a-done", "b-replaced", "f-waiting", "g-leased", "i-resting"}
        assert {scene_id.split("/")[0] for scene_id in world.ids()} == done
        changed = of_old(
            "a-done", "9"
        )  # else the logs have the same bytes, and one is mined for all
        world.ledger.sync_recordings([changed, of_old("c-deleted", "1")])
        of_c = [scene_id for scene_id in world.ids() if scene_id.startswith("c-deleted")]
        assert len(of_c) == 6
        world.ledger.sync_recordings([changed, of_old("b-replaced", "1")])
        b_scenes = [s for s in world.ledger.current_scenes() if s.log_id == "b-replaced"]
        assert {scene.pipeline_version for scene in b_scenes} == {"p1"}
        world.mine_all("p2")
        assert {s.pipeline_version for s in world.ledger.current_scenes()} == {"p2"}


class TestUpgradeOnSqlite(OnSqlite, UpgradeContract):
    def test_a_state_that_is_only_read_is_not_brought_up_to_date(self) -> None:
        with pytest.raises(StateUnusableError, match="start the service on it once"):
            open_store_to_read(self.folder)


@pytest.mark.integration
class TestUpgradeOnPostgres(OnPostgres, UpgradeContract):
    pass
