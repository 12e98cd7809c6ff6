"""A database taken from under a running service: it acknowledges nothing more, and says why."""

import os
import re
import shutil
import sqlite3
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from sqlalchemy import create_engine, text

from service.cli.main import main
from service.store.engine import DATABASE_NAME
from tests.contracts.databases import postgres_server
from tests.integration.test_state_faults import DEADLINE_S, Run, running

pytestmark = [pytest.mark.integration, pytest.mark.timeout(600)]

Loss = Callable[[Path], None]


def delete(database: Path) -> None:
    database.unlink()


def delete_with_its_journal(database: Path) -> None:
    for path in (database, *(database.with_name(database.name + end) for end in ("-wal", "-shm"))):
        path.unlink()


def delete_the_journal(database: Path) -> None:
    database.with_name(f"{database.name}-wal").unlink()


def move_away(database: Path) -> None:
    database.rename(database.with_name("elsewhere"))


def replace_by_a_copy(database: Path) -> None:
    copy = database.with_name("copy")
    shutil.copy(database, copy)
    copy.rename(database)


def cut_in_half(database: Path) -> None:
    os.truncate(database, database.stat().st_size // 2)


def cut_the_journal(database: Path) -> None:
    os.truncate(database.with_name(f"{database.name}-wal"), 0)


def overwrite(database: Path) -> None:
    """Write another copy over the file, in place and of the same size, as `cp` does."""
    copy = database.with_name("copy")
    with closing(sqlite3.connect(database)) as opened:
        opened.execute("VACUUM INTO ?", (str(copy),))
    content = copy.read_bytes()
    with database.open("r+b") as file:
        file.write(content.ljust(database.stat().st_size, b"\0"))


LOSSES: dict[str, tuple[Loss, str]] = {
    "deleted": (delete, "was deleted or moved away"),
    "deleted with its journal": (delete_with_its_journal, "was deleted or moved away"),
    "its journal deleted": (delete_the_journal, "was deleted or moved away"),
    "moved": (move_away, "was deleted or moved away"),
    "replaced": (replace_by_a_copy, "was replaced by another file"),
    "cut": (cut_in_half, "was cut from"),
    "overwritten": (overwrite, "was overwritten by another program"),
    "its journal cut": (cut_the_journal, "was cut from"),
}


def assert_it_ends(run: Run, sentence: str) -> None:
    """The service ends as one that must not be restarted, and says why in one sentence."""
    end_s = time.monotonic() + DEADLINE_S
    while run.service.ended() is None:
        assert time.monotonic() < end_s, run.service.words()
        time.sleep(0.05)
    assert run.service.ended() == 1, run.service.words()
    errors = [line for line in run.service.said().splitlines() if line.startswith("error: ")]
    assert len(errors) == 1, run.service.words()
    assert re.search(sentence, errors[0]), errors[0]
    assert "Traceback" not in run.service.said(), run.service.words()


@pytest.mark.parametrize("loss", LOSSES)
def test_a_database_file_that_is_lost_ends_the_service(tmp_path: Path, loss: str) -> None:
    lose, what = LOSSES[loss]
    with running(tmp_path, tmp_path / "state") as run:
        lose(run.state / DATABASE_NAME)
        assert_it_ends(run, f"the database {what}.* nothing is acknowledged any more: .*restore")


def test_what_was_acknowledged_before_the_file_moved_is_in_it(tmp_path: Path) -> None:
    with running(tmp_path, tmp_path / "state") as run:
        acknowledged = run.done()
        for end in ("", "-wal", "-shm"):
            path = run.state / f"{DATABASE_NAME}{end}"
            path.rename(tmp_path / path.name)
        assert_it_ends(run, "was deleted or moved away")
        with closing(sqlite3.connect(tmp_path / DATABASE_NAME)) as moved:
            (done,) = moved.execute("SELECT count(*) FROM shards WHERE state = 'done'").fetchone()
        assert done >= acknowledged


def test_a_copy_and_a_touch_of_the_file_are_no_loss(tmp_path: Path) -> None:
    with running(tmp_path, tmp_path / "state") as run:
        database = run.state / DATABASE_NAME
        with closing(sqlite3.connect(database)) as backup:
            backup.execute("VACUUM INTO ?", (str(tmp_path / "backup"),))
        os.utime(database)
        before = run.done()
        run.until(lambda: run.done() > before, "more shards done")
        run.assert_complete()


def test_half_a_database_is_refused_by_every_verb(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with running(tmp_path, tmp_path / "state") as run:
        run.until(lambda: run.done() >= 20, "some shards done")
        assert run.service.stop() == 0  # the journal is empty, and what follows is little
        run.service.start()
        run.until(lambda: run.done() >= 20, "the service is back")
        run.service.kill()
        assert (run.state / f"{DATABASE_NAME}-wal").stat().st_size > 0
        cut_in_half(run.state / DATABASE_NAME)
        run.service.start()
        assert_it_ends(run, "not a database, or a damaged one: .*restore it from a copy")
    show = ("show", "log-00/lidar/1", "--out", str(tmp_path / "picture.png"))
    for verb in (("top",), show, ("select", "--budget", "3"), ("rates",), ("status",)):
        assert main([*verb, "--state", str(tmp_path / "state")]) == 1
        told = capsys.readouterr().err
        assert "not a database, or a damaged one" in told, verb
        assert told.count("\n") == 1, told


# PostgreSQL.


class Server:
    """Databases of one PostgreSQL, as its administrator sees them."""

    def __init__(self, url: str) -> None:
        self._url = url
        self.url = f"{url}/ledger"
        self._admin = create_engine(f"{url}/postgres", isolation_level="AUTOCOMMIT")
        self.do("CREATE DATABASE ledger")

    def do(self, statement: str) -> None:
        with self._admin.connect() as connection:
            connection.execute(text(statement))

    def dump(self, file: Path) -> None:
        self._program("pg_dump", "--format=custom", f"--file={file}")

    def restore(self, file: Path) -> None:
        self._program("pg_restore", str(file))

    def restore_in_place(self, file: Path) -> None:
        end_s = time.monotonic() + DEADLINE_S
        while True:
            try:
                self._program("pg_restore", "--clean", "--single-transaction", str(file))
            except subprocess.CalledProcessError:  # a deadlock with a reader: it is tried again
                assert time.monotonic() < end_s
            else:
                return

    def drop(self) -> None:
        self.do("DROP DATABASE ledger WITH (FORCE)")

    def close(self) -> None:
        self._admin.dispose()

    def _program(self, program: str, *arguments: str) -> None:
        folder = sorted(Path("/usr/lib/postgresql").glob("*/bin"))[-1]
        at = self.url.replace("+psycopg", "")
        subprocess.run([folder / program, f"--dbname={at}", *arguments], check=True, timeout=60)


@pytest.fixture
def server() -> Iterator[Server]:
    with postgres_server() as url:
        made = Server(url)
        yield made
        made.close()


@contextmanager
def running_on(server: Server, folder: Path) -> Iterator[Run]:
    with running(folder, folder / "state", {"COUNTERPOINT_DATABASE": server.url}) as run:
        yield run


def test_a_database_that_was_dropped_ends_the_service(server: Server, tmp_path: Path) -> None:
    with running_on(server, tmp_path) as run:
        server.drop()
        assert_it_ends(run, "the database was dropped while the service ran .*restore it from a")


def test_a_database_that_was_made_afresh_ends_the_service(server: Server, tmp_path: Path) -> None:
    with running_on(server, tmp_path) as run:
        server.drop()
        server.do("CREATE DATABASE ledger")
        assert_it_ends(run, "no longer the database that this service wrote: its tables are gone")


@pytest.mark.parametrize("how", ["dropped before", "in place"])
def test_a_database_restored_from_an_older_copy_ends_the_service(server: Server, how: str) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with running_on(server, folder) as run:
            server.dump(folder / "dump")
            before = run.done()
            run.until(lambda: run.done() >= before + 3, "more shards done")
            if how == "in place":
                server.restore_in_place(folder / "dump")
            else:
                server.drop()
                server.do("CREATE DATABASE ledger")
                server.restore(folder / "dump")
            assert_it_ends(run, "no longer the database that this service wrote: ")
