"""Writers that come at once share a transaction, and nothing else."""

import sqlite3
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from threading import Event

import pytest
from sqlalchemy import Connection

from service.errors import StateUnusableError
from service.store import sqlite
from service.store.engine import DATABASE_NAME, Store, StoreUnavailableError, open_store

WRITERS = 8


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    opened = open_store(tmp_path)
    yield opened
    opened.close()


def enter(name: str, *, transactions: set[int] | None = None) -> Callable[[Connection], str]:
    def work(connection: Connection) -> str:
        text = (
            "INSERT INTO pipelines SELECT ?, coalesce(max(ordinal), 0) + 1, '', '', '' "
            "FROM pipelines"
        )
        connection.exec_driver_sql(text, (name,))
        if transactions is not None:
            transactions.add(id(connection))
        if name.startswith("bad"):
            raise ValueError(name)
        return name

    return work


def entered(store: Store) -> list[str]:
    with store.reading() as connection:
        found = connection.exec_driver_sql(
            "SELECT pipeline_version FROM pipelines ORDER BY ordinal"
        )
        return [str(name) for (name,) in found]


def together(
    store: Store, pool: ThreadPoolExecutor, works: list[Callable[[Connection], str]]
) -> list[Future[str]]:
    """Let one writer hold up the others, so that they are one group."""
    leading, go_on = Event(), Event()

    def hold_up(connection: Connection) -> str:
        leading.set()
        assert go_on.wait(20)
        return enter("first")(connection)

    first = pool.submit(store.write, hold_up)
    assert leading.wait(20)
    rest = [pool.submit(store.write, work) for work in works]
    while len(store._groups._waiting) < len(works):
        assert not first.done()
    go_on.set()
    assert first.result() == "first"
    return rest


def test_those_that_come_while_one_is_on_its_way_share_a_transaction(store: Store) -> None:
    transactions: set[int] = set()
    names = [f"writer-{number}" for number in range(WRITERS)]
    with ThreadPoolExecutor(WRITERS + 1) as pool:
        works = [enter(name, transactions=transactions) for name in names]
        answers = [future.result() for future in together(store, pool, works)]
    assert answers == names
    assert len(transactions) == 1
    assert sorted(entered(store)) == sorted(["first", *names])


def test_the_error_of_one_is_his_alone(store: Store) -> None:
    names = ["good-1", "bad", "good-2"]
    with ThreadPoolExecutor(4) as pool:
        good, bad, better = together(store, pool, [enter(name) for name in names])
        assert (good.result(), better.result()) == ("good-1", "good-2")
        with pytest.raises(ValueError, match="bad"):
            bad.result()
    assert sorted(entered(store)) == ["first", "good-1", "good-2"]


def test_one_alone_fails_alone_and_the_next_goes_on(store: Store) -> None:
    with pytest.raises(ValueError, match="bad"):
        store.write(enter("bad"))
    assert store.write(enter("good")) == "good"
    assert entered(store) == ["good"]


def test_a_refused_transaction_refuses_everyone_of_its_group_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sqlite, "BUSY_TIMEOUT_MS", 200)
    store = open_store(tmp_path)
    other = sqlite3.connect(tmp_path / DATABASE_NAME, isolation_level=None)
    with closing(store), closing(other), ThreadPoolExecutor(WRITERS) as pool:
        other.execute("BEGIN IMMEDIATE")
        refused = [pool.submit(store.write, enter(f"w{number}")) for number in range(WRITERS)]
        for future in refused:
            with pytest.raises(StoreUnavailableError, match="database is locked"):
                future.result()
        other.execute("ROLLBACK")
        assert store.write(enter("after")) == "after"
        assert entered(store) == ["after"]


def test_a_disk_that_is_full_or_read_only_may_pass(store: Store) -> None:
    def fill(connection: Connection) -> None:
        connection.exec_driver_sql("PRAGMA max_page_count=1")
        blob = "INSERT INTO pipelines SELECT hex(randomblob(200000)), 1, '', '', ''"
        connection.exec_driver_sql(blob)

    def write_where_one_may_only_read(connection: Connection) -> None:
        connection.exec_driver_sql("PRAGMA query_only=ON")
        enter("never")(connection)

    with pytest.raises(StoreUnavailableError, match="database or disk is full"):
        store.write(fill)
    with pytest.raises(StoreUnavailableError, match="attempt to write a readonly database"):
        store.write(write_where_one_may_only_read)


def test_a_damaged_page_does_not_pass(tmp_path: Path) -> None:
    store = open_store(tmp_path)
    for number in range(200):
        store.write(enter(f"{number}-" + "x" * 200))
    store.close()
    file = tmp_path / DATABASE_NAME
    content = file.read_bytes()
    file.write_bytes(content[:8192] + b"\xff" * (len(content) - 8192))
    with closing(sqlite3.connect(file)) as check:
        assert check.execute("PRAGMA user_version").fetchone() == (0,)  # it still opens
    with pytest.raises(StateUnusableError, match="a damaged one"):
        open_store(tmp_path).write(enter("more"))
