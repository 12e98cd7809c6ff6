"""The ledger on its SQLite file: durability, readers beside a writer, a disk that is full."""

import json
import resource
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import event

from service.errors import NothingFoundError, StateUnusableError
from service.store import migrations, sqlite
from service.store.engine import DATABASE_NAME, open_store, open_store_to_read
from service.store.faults import StoreUnavailableError
from service.store.ledger import Ledger
from service.store.work_items import Work, WorkState, change
from tests.contracts.ledger_world import World, expected_scenes


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    store = open_store(tmp_path)
    yield World.on(store)
    store.close()


def test_what_is_acknowledged_is_synced_to_disk(world: World) -> None:
    with world.store.reading() as connection:
        assert connection.exec_driver_sql("PRAGMA journal_mode").scalar_one() == "wal"
        assert connection.exec_driver_sql("PRAGMA synchronous").scalar_one() == 2


def test_a_broken_transaction_leaves_nothing(world: World) -> None:
    world.listed("a")
    world.plan_all()
    work = Work("a", world.mine_lease().recording.revision, "p1", "lidar-00000")
    with pytest.raises(ZeroDivisionError), world.store.writing() as connection:  # noqa: PT012
        change(connection, work, state=WorkState.PARKED)
        _ = 1 // 0
    assert world.shards("parked") == 0


def test_readers_see_the_last_commit_while_a_writer_is_at_work(world: World) -> None:
    world.listed("a")
    world.mine_all()
    with world.store.writing() as connection:
        connection.exec_driver_sql("DELETE FROM scenes")
        found: list[int] = []
        reader = threading.Thread(target=lambda: found.append(len(world.ids())))
        reader.start()
        reader.join(timeout=5)
        assert found == [9]
        connection.exec_driver_sql("ROLLBACK")
        connection.exec_driver_sql("BEGIN")  # for the end of the block


def test_the_state_can_be_read_beside_a_service_and_without_one(tmp_path: Path) -> None:
    store = open_store(tmp_path)
    world = World.on(store)
    world.listed("a", "b")
    world.plan_all()
    beside = open_store_to_read(tmp_path)
    reader = Ledger(beside, now_s=world.clock)
    assert reader.current_scenes() == []
    world.mine_all()
    assert {scene.scene_id for scene in reader.current_scenes()} == set(expected_scenes("ab"))
    with pytest.raises(StoreUnavailableError, match="readonly"):
        reader.expire()
    beside.close()
    store.close()
    alone = open_store_to_read(tmp_path)
    assert Ledger(alone, now_s=world.clock).status().scenes == 18
    alone.close()


def test_a_folder_name_with_odd_characters_is_no_obstacle(tmp_path: Path) -> None:
    folder = tmp_path / "state? #1 50% ü"
    folder.mkdir()
    open_store(folder).close()
    open_store_to_read(folder).close()
    assert (folder / DATABASE_NAME).is_file()


def test_reading_a_state_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StateUnusableError, match=r"no state to read: .* does not exist"):
        open_store_to_read(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_reading_a_state_of_an_older_version_is_refused(tmp_path: Path) -> None:
    open_store(tmp_path).close()
    with sqlite3.connect(tmp_path / DATABASE_NAME) as connection:
        connection.execute("DELETE FROM schema_version WHERE version > 1")
    connection.close()
    with pytest.raises(StateUnusableError, match="start the service on it once"):
        open_store_to_read(tmp_path)


def test_an_upgrade_that_breaks_off_leaves_the_old_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as newer:
        newer.setattr(migrations, "STEPS", (*migrations.STEPS, "9999_missing.sql"))
        newer.setattr(migrations, "SCHEMA_VERSION", len(migrations.STEPS))
        with pytest.raises(FileNotFoundError):
            open_store(tmp_path)
    with sqlite3.connect(tmp_path / DATABASE_NAME) as connection:
        assert connection.execute("SELECT name FROM sqlite_master").fetchall() == []
    connection.close()
    open_store(tmp_path).close()


def test_a_file_that_is_no_database_is_refused(tmp_path: Path) -> None:
    (tmp_path / DATABASE_NAME).write_bytes(b"not a database, " * 100)
    with pytest.raises(StateUnusableError, match="not a database"):
        open_store(tmp_path)


def test_a_database_that_stays_locked_is_worth_another_try(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sqlite, "BUSY_TIMEOUT_MS", 50)
    store = open_store(tmp_path)
    world = World.on(store)
    intruder = sqlite3.connect(tmp_path / DATABASE_NAME, isolation_level=None)
    intruder.execute("BEGIN IMMEDIATE")
    with pytest.raises(StoreUnavailableError, match="database is locked"):
        world.listed("a")
    intruder.execute("ROLLBACK")
    intruder.close()
    world.listed("a")
    store.close()


def test_a_full_disk_loses_nothing_that_was_acknowledged(tmp_path: Path) -> None:
    store = open_store(tmp_path)
    world = World.on(store)
    world.listed("a")
    world.plan_all()
    assert world.commit_shard(world.mine_lease()).ok
    before, lease = world.ids(), world.mine_lease()
    with store.reading() as connection:  # the one pooled connection
        pages = connection.exec_driver_sql("PRAGMA page_count").scalar_one()
        connection.exec_driver_sql(f"PRAGMA max_page_count={pages}")
    with pytest.raises(StoreUnavailableError, match="full"):  # noqa: PT012
        world.commit_shard(lease)
        world.commit_shard(world.mine_lease())
        world.listed(*(f"log-{number}" for number in range(1000)))
    with store.reading() as connection:
        connection.exec_driver_sql("PRAGMA max_page_count=1000000")
    assert set(before) <= set(world.ids())
    world.listed("a")
    assert world.commit_shard(lease).ok
    world.ledger.free_leases("")
    world.mine_all()
    assert set(world.ids()) == set(expected_scenes("a"))
    store.close()


def test_a_failed_write_stands_until_a_write_works_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sqlite, "BUSY_TIMEOUT_MS", 50)
    store = open_store(tmp_path)
    world = World.on(store)
    assert world.ledger.cannot_write == ""
    intruder = sqlite3.connect(tmp_path / DATABASE_NAME, isolation_level=None)
    intruder.execute("BEGIN IMMEDIATE")
    with pytest.raises(StoreUnavailableError):
        world.listed("a")
    assert world.ledger.last_seq() == 0, "it can be read"
    assert world.ledger.cannot_write.startswith("cannot use the database: database is locked")
    intruder.execute("ROLLBACK")
    intruder.close()
    assert "is locked" in world.ledger.cannot_write, "nothing has been written since"
    with pytest.raises(NothingFoundError):  # refused before anything is written
        world.ledger.retry(["stranger"])
    assert "is locked" in world.ledger.cannot_write
    world.ledger.expire()
    assert world.ledger.cannot_write == ""
    store.close()


def test_on_a_full_disk_a_ledger_with_nothing_to_do_finds_out_that_it_cannot_write(
    tmp_path: Path,
) -> None:
    store = open_store(tmp_path)
    world = World.on(store)
    world.ledger.expire()
    with no_file_grows_beyond((tmp_path / f"{DATABASE_NAME}-wal").stat().st_size):
        world.ledger.expire()
        assert world.ledger.cannot_write == "", "nothing to expire, nothing written"
        for _ in range(2):
            world.clock.now_s += 30
            with pytest.raises(StoreUnavailableError, match="disk I/O error"):
                world.ledger.expire()
            assert "disk I/O error" in world.ledger.cannot_write
        with pytest.raises(StoreUnavailableError, match="disk I/O error"):
            world.ledger.expire()  # after a failure each one has to prove it
    world.ledger.expire()
    assert world.ledger.cannot_write == ""
    store.close()


@contextmanager
def no_file_grows_beyond(size: int) -> Iterator[None]:
    """Let the kernel refuse it to this process, as a disk without room would."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_claims_and_the_outbox_look_things_up_in_indexes(world: World) -> None:
    """However many shards lie in the ledger, no request reads them all."""
    world.listed(*(f"log-{number}" for number in range(8)))
    asked: list[tuple[str, Any]] = []

    def note(_c: Any, _cursor: Any, statement: str, parameters: Any, *_rest: Any) -> None:
        asked.append((statement, parameters))

    event.listen(world.store._engine, "before_cursor_execute", note)
    world.plan_all()
    lease = world.mine_lease()
    assert world.commit_shard(lease).ok
    world.ledger.expire()
    world.ledger.unpublished(10)
    world.ledger.scene("log-0/lidar/0")
    world.ledger.scenes_since(1, 10)
    event.remove(world.store._engine, "before_cursor_execute", note)
    small = {"pipelines", "counters", "schema_version", "write_proof"}
    for statement, parameters in asked:
        if not statement.startswith(("SELECT", "UPDATE")):
            continue
        with world.store.reading() as connection:
            steps = connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", parameters).all()
        for step in steps:
            detail = str(step[3])
            scanned = detail.startswith("SCAN") and detail.split()[1] not in small
            # Held leases are few and have an index of their own: to read all of those is fine.
            assert not scanned or "leases_held" in detail or "anon_" in detail, statement
            assert "TEMP B-TREE" not in detail, (detail, statement)


def test_status_survives_the_way_over_the_bus(world: World) -> None:
    world.listed("a", "b")
    world.mine_all()
    status = world.ledger.status()
    assert type(status).model_validate_json(json.dumps(status.model_dump(mode="json"))) == status
