"""A stored record that is not what its digest says is named and counted, and never shown."""

import hashlib
import json
from typing import Any

import pytest
from sqlalchemy import select, update
from structlog.testing import capture_logs

from service.errors import RecordDamagedError
from service.store.tables import SCENES
from service.store.transaction_effects import Effects
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World
from tests.contracts.store_contract import StoreContract

CHANGES: dict[str, Any] = {
    "record": b'{"scene_id":"another"}',
    "sha256": "0" * 64,
    "score": 0.123,
    "reasons": '["nothing"]',
    "end_ns": 17,
}
"""What a damaged byte may make of each column that is shown."""

SHOWN_BY_THE_RANKING = frozenset(CHANGES)
PUBLISHED = frozenset({"record", "sha256", "score"})


class Counted:
    def __init__(self) -> None:
        self.damaged = 0

    def on_effects(self, effects: Effects) -> None:
        pass

    def on_database_error(self) -> None:
        raise AssertionError("the database answers")

    def on_damaged_record(self) -> None:
        self.damaged += 1


def flip_a_byte(record: bytes) -> bytes:
    middle = len(record) // 2
    return record[:middle] + bytes((record[middle] ^ 1,)) + record[middle + 1 :]


class DamagedRecordContract(StoreContract):
    @pytest.fixture
    def mined(self, world: World) -> World:
        world.listed("a")
        world.mine_all()
        self.counted = Counted()
        world.ledger.observe(self.counted)
        self.scene_id = world.ids()[4]
        return world

    def change(self, world: World, **values: Any) -> None:
        with world.store.writing() as connection:
            here = SCENES.c.scene_id == self.scene_id
            connection.execute(update(SCENES).where(here).values(**values))

    def flip(self, world: World) -> None:
        with world.store.reading() as connection:
            here = SCENES.c.scene_id == self.scene_id
            record = connection.execute(select(SCENES.c.record).where(here)).scalar_one()
        self.change(world, record=flip_a_byte(bytes(record)))

    def test_a_flipped_byte_is_named_once_and_the_others_go_on(self, mined: World) -> None:
        self.flip(mined)
        ledger = mined.ledger
        with capture_logs() as logs:
            for _ in range(2):
                shown = (
                    [scene.scene_id for scene in ledger.ranking()],
                    [scene.scene_id for scene in ledger.ranking(most=9)],
                    [scene.scene_id for scene in ledger.current_scenes()],
                    [scene.scene_id for scene in ledger.scenes_since(0)],
                    [scene.scene_id for scene in ledger.events_since(0, 100)],
                    [scene.scene_id for scene in ledger.newest_scenes(9)],
                    [scene.scene_id for scene in ledger.unpublished(100)],
                )
                for scene_ids in shown:
                    assert len(scene_ids) == len(set(scene_ids)) == 8
                    assert self.scene_id not in scene_ids
                chosen = {scene.scene_id for scene in ledger.proposals.select(budget=9)}
                assert self.scene_id not in chosen
        said = [line for line in logs if line["log_level"] == "error"]
        assert [line["scene_id"] for line in said] == [self.scene_id]
        assert "are not those of its digest" in said[0]["problem"]
        assert self.counted.damaged == 1
        assert [scene.rank for scene in ledger.ranking()] == list(range(1, 9))
        with pytest.raises(RecordDamagedError, match=f"record of {self.scene_id} is damaged"):
            ledger.scene(self.scene_id)

    @pytest.mark.parametrize("column", CHANGES)
    def test_a_column_that_differs_from_its_record_is_not_shown(
        self, mined: World, column: str
    ) -> None:
        self.change(mined, **{column: CHANGES[column]})
        ranked = {scene.scene_id for scene in mined.ledger.ranking()}
        published = {scene.scene_id for scene in mined.ledger.unpublished(100)}
        assert (self.scene_id in ranked) == (column not in SHOWN_BY_THE_RANKING)
        assert (self.scene_id in published) == (column not in PUBLISHED)
        assert len(ranked) == 8

    def test_pages_that_are_damaged_from_end_to_end_do_not_end_the_history(
        self, mined: World
    ) -> None:
        with mined.store.writing() as connection:
            connection.execute(update(SCENES).where(SCENES.c.seq <= 5).values(record=b"{}"))
        ledger = mined.ledger
        for page in (ledger.unpublished(2), ledger.scenes_since(0, 2), ledger.events_since(0, 2)):
            assert [scene.seq for scene in page] == [6]
        assert [scene.seq for scene in ledger.scenes_since(6, 2)] == [7, 8]
        assert self.counted.damaged == 5

    def test_the_streams_are_named_by_a_record_that_is_sound(self, mined: World) -> None:
        before = mined.ledger.status().judged
        first = min(mined.ids())
        with mined.store.writing() as connection:
            here = SCENES.c.scene_id == first
            connection.execute(update(SCENES).where(here).values(record=b"{"))
        assert mined.ledger.status().judged == before
        with mined.store.writing() as connection:
            connection.execute(update(SCENES).values(record=b"{"))
        assert mined.ledger.status().judged == ()

    def test_a_record_that_another_encoder_wrote_is_sound(self, mined: World) -> None:
        with mined.store.reading() as connection:
            here = SCENES.c.scene_id == self.scene_id
            record = connection.execute(select(SCENES.c.record).where(here)).scalar_one()
        spaced = json.dumps(json.loads(bytes(record)), indent=1).encode()
        self.change(mined, record=spaced, sha256=hashlib.sha256(spaced).hexdigest())
        assert self.scene_id in {scene.scene_id for scene in mined.ledger.ranking()}
        assert mined.ledger.scene(self.scene_id) is not None
        assert self.counted.damaged == 0


class TestDamagedRecordsOnSqlite(OnSqlite, DamagedRecordContract):
    def test_text_that_is_no_longer_utf8_is_named_too(self, mined: World) -> None:
        with mined.store.writing() as connection:
            connection.exec_driver_sql(
                "UPDATE scenes SET reasons = CAST(X'5b22ff225d' AS TEXT) WHERE scene_id = ?",
                (self.scene_id,),
            )
        assert self.scene_id not in {scene.scene_id for scene in mined.ledger.ranking()}
        assert self.counted.damaged == 1


@pytest.mark.integration
class TestDamagedRecordsOnPostgres(OnPostgres, DamagedRecordContract):
    pass
