"""A database file lost under an open store: the error says what happened to it, once."""

import os
import sqlite3
from pathlib import Path

import pytest
from sqlalchemy import event, text
from sqlalchemy.pool import Pool

from service.errors import StateUnusableError
from service.store.engine import DATABASE_NAME, Store, open_store


@pytest.fixture
def store(tmp_path: Path) -> Store:
    opened = open_store(tmp_path)
    opened.bring_up_to_date()
    return opened


def _cut(store: Store, folder: Path) -> None:
    """Fail as the driver does that meets a file without its header."""
    damaged = sqlite3.DatabaseError("file is not a database")
    damaged.sqlite_errorcode, damaged.sqlite_errorname = sqlite3.SQLITE_NOTADB, "SQLITE_NOTADB"
    with store.reading():
        os.truncate(folder / f"{DATABASE_NAME}-wal", 0)
        raise damaged


def test_a_file_that_the_driver_calls_damaged_is_told_as_cut(store: Store, tmp_path: Path) -> None:
    with pytest.raises(StateUnusableError, match=r"was cut from .* restore"):
        _cut(store, tmp_path)


def test_a_connection_that_cannot_be_reset_prints_no_traceback(
    store: Store, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: object) -> None:
        raise sqlite3.OperationalError("disk I/O error")

    event.listen(Pool, "reset", fail)
    try:
        with store.reading() as connection:
            connection.execute(text("SELECT 1"))
    finally:
        event.remove(Pool, "reset", fail)
        store.close()
    assert [each.name for each in caplog.records if each.name.startswith("sqlalchemy")] == []
