"""A cut, an empty and a damaged database are refused; its journal may complete one."""

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from service.doctor import stores as doctor_stores
from service.errors import StateUnusableError
from service.settings.config import Settings
from service.store import file_check
from service.store.engine import DATABASE_NAME, open_store, open_store_to_read
from service.store.file_check import traces_of_loss
from tests.contracts.ledger_world import World

DAMAGED = "not a database, or a damaged one: "


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """A closed database of some hundred pages."""
    with closing(open_store(tmp_path)) as store:
        world = World.on(store)
        world.listed(*(f"log-{number}" for number in range(12)))
        world.mine_all()
    return tmp_path / DATABASE_NAME


def page_of(database: Path, table: str) -> int:
    with closing(sqlite3.connect(database)) as connection:
        query = "SELECT rootpage FROM sqlite_schema WHERE name = ?"
        return int(connection.execute(query, (table,)).fetchone()[0])


def damage_page(database: Path, page: int) -> None:
    content = bytearray(database.read_bytes())
    content[(page - 1) * 4096 : page * 4096] = b"\xff" * 4096
    database.write_bytes(content)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.5, 0.99])
def test_a_part_of_a_database_is_refused_for_writing_and_reading(
    database: Path, share: float
) -> None:
    content = database.read_bytes()
    part = content[: int(len(content) * share)]
    database.write_bytes(part)
    for opening in (open_store, open_store_to_read):
        with pytest.raises(StateUnusableError, match=f"{DAMAGED}.*restore it from a copy"):
            opening(database.parent)
        assert database.read_bytes() == part, "it is not written"
    assert [path.name for path in database.parent.iterdir()] == [DATABASE_NAME]


def test_what_the_journal_holds_need_not_be_in_the_file(tmp_path: Path) -> None:
    with closing(open_store(tmp_path)) as store:
        world = World.on(store)
        world.listed("a")
        world.mine_all()
        killed = tmp_path / "killed"
        killed.mkdir()
        for path in tmp_path.glob(f"{DATABASE_NAME}*"):
            shutil.copy(path, killed)
        ids = world.ids()
    assert (killed / f"{DATABASE_NAME}-wal").stat().st_size > 0
    with closing(open_store(killed)) as store:
        assert World.on(store).ids() == ids


def test_a_damaged_page_is_refused_at_the_start(database: Path) -> None:
    damage_page(database, page_of(database, "scenes"))
    with pytest.raises(StateUnusableError, match=DAMAGED):
        open_store(database.parent)


def test_of_a_very_large_one_the_scenes_are_left_to_doctor(
    database: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_check, "CHECKED_WHOLE_BYTES", 0)
    sound = database.read_bytes()
    damage_page(database, page_of(database, "scenes"))
    open_store(database.parent).close()
    settings = Settings(state=database.parent)
    with pytest.raises(StateUnusableError, match=DAMAGED):
        list(doctor_stores.database(settings))
    database.write_bytes(sound)
    assert [finding.verdict for finding in doctor_stores.database(settings)] == ["ok"]
    damage_page(database, page_of(database, "shards"))
    with pytest.raises(StateUnusableError, match=DAMAGED):
        open_store(database.parent)


def test_what_a_lost_database_leaves_behind_is_named(tmp_path: Path) -> None:
    path = tmp_path / "counterpoint.sqlite"
    assert traces_of_loss(path) == ""
    (tmp_path / "artifacts").mkdir()
    assert traces_of_loss(path) == ""
    (tmp_path / "artifacts" / "a.overlay").write_bytes(b"x")
    assert "overlays are left: put a backup in its place" in traces_of_loss(path)
    path.write_bytes(b"")
    assert traces_of_loss(path) == ""
