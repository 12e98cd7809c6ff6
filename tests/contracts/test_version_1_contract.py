"""A database with records of version 1: ranked, shown and published as they were stored."""

import json
from typing import Any

import pytest
from sqlalchemy import select, update

from schemas.canonical import canonical_json, sha256
from schemas.score import SceneScore
from schemas.transport.bus import RECORD, RECORD_V1, encoding_of
from schemas.transport.wire import decode
from service.store.tables import SCENES
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World, mined, shard_commit
from tests.contracts.store_contract import StoreContract

SENTENCE = "pedestrian seen moving by the supervised stream alone for 2.0 s, 13 m ahead"


def version_1_of(record: bytes) -> bytes:
    """Return the record as a service of version 1 would have written it."""
    written: dict[str, Any] = json.loads(record)
    return canonical_json({**written, "schema_version": 1, "reasons": [SENTENCE]})


class Version1Contract(StoreContract):
    @pytest.fixture
    def old(self, world: World) -> World:
        """A ledger in which every second record is of version 1."""
        world.listed("a")
        world.mine_all()
        for scene_id in world.ids()[::2]:
            here = SCENES.c.scene_id == scene_id
            with world.store.writing() as connection:
                record = connection.execute(select(SCENES.c.record).where(here)).scalar_one()
                old = version_1_of(bytes(record))
                reasons = canonical_json([SENTENCE]).decode()
                values = {"record": old, "sha256": sha256(old), "reasons": reasons}
                connection.execute(update(SCENES).where(here).values(values))
        return world

    def test_old_and_new_records_are_ranked_together(self, old: World) -> None:
        rows = {row.scene_id: row for row in old.ledger.ranking()}
        assert len(rows) == len(old.ids())
        for number, scene_id in enumerate(old.ids()):
            assert (SENTENCE in rows[scene_id].reasons) is (number % 2 == 0)

    def test_an_old_record_keeps_its_bytes_and_its_digest(self, old: World) -> None:
        first, second = (old.ledger.scene(scene_id) for scene_id in old.ids()[:2])
        assert first is not None
        assert second is not None
        assert sha256(first.record) == first.sha256
        assert encoding_of(first.record) == RECORD_V1
        assert encoding_of(second.record) == RECORD
        score = decode(SceneScore, first.record)
        assert (score.sentences_version, score.reasons[0].headline) == (1, SENTENCE)

    def test_no_worker_commits_a_record_of_version_1(self, world: World) -> None:
        world.listed("a")
        world.commit_plan(world.plan_lease())
        lease = world.mine_lease()
        records = {sha256(old): old for old in map(version_1_of, mined(lease.shard).values())}
        answer = world.ledger.commit(shard_commit(lease, records), records)
        assert "a record of an earlier version; update the worker" in str(answer)
        assert not world.ids()


class TestVersion1OnSqlite(OnSqlite, Version1Contract):
    pass


@pytest.mark.integration
class TestVersion1OnPostgres(OnPostgres, Version1Contract):
    pass
