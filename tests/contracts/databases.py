"""The databases that the ledger's contracts are run on: a SQLite file, and a real PostgreSQL."""

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from sqlalchemy import Engine, create_engine, text

from service.store.engine import DATABASE_NAME, Store, open_store, open_store_at
from tests.free_ports import free_port
from tests.needed import needed


class OnSqlite:
    """Put it before a contract: `make_store` opens one file, again and again."""

    @pytest.fixture(autouse=True)
    def database(self, tmp_path: Path) -> None:
        self.folder = tmp_path

    def make_store(self) -> Store:
        return open_store(self.folder)

    def make_engine(self) -> Engine:
        return create_engine(f"sqlite:///{self.folder / DATABASE_NAME}")


class OnPostgres:
    """Put it before a contract: `make_store` opens one database, again and again."""

    @pytest.fixture(autouse=True)
    def database(self, postgres: str, request: pytest.FixtureRequest) -> Iterator[None]:
        name = f"test_{hashlib.sha256(request.node.nodeid.encode()).hexdigest()[:16]}"
        admin = create_engine(f"{postgres}/postgres", isolation_level="AUTOCOMMIT")
        with admin.connect() as connection:
            connection.execute(text(f"CREATE DATABASE {name}"))
        self.url = f"{postgres}/{name}"
        yield
        with admin.connect() as connection:
            connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
        admin.dispose()

    def make_store(self) -> Store:
        return open_store_at(self.url)

    def make_engine(self) -> Engine:
        return create_engine(self.url)


@contextmanager
def postgres_server() -> Iterator[str]:
    """Run a server of our own on a free port; gives the URL in front of a database's name."""
    needed("psycopg", "the extra `postgres`")
    programs = sorted(Path("/usr/lib/postgresql").glob("*/bin"))
    if not programs:
        pytest.skip("needs Debian's package `postgresql`")
    # Not in pytest's own folders: they are closed to the user that the server must run as.
    folder = Path(tempfile.mkdtemp(prefix="postgres-"))
    is_root = os.geteuid() == 0
    if is_root:
        shutil.chown(folder, "postgres", "postgres")

    def run(program: str, *arguments: str) -> None:
        before = ("setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups")
        command = [*(before if is_root else ()), str(programs[-1] / program), *arguments]
        subprocess.run(command, check=True, cwd="/", stdout=subprocess.DEVNULL, timeout=60)

    port = free_port()
    data, log = str(folder / "data"), str(folder / "log")
    # Nothing here outlives its test, nor pulls the plug: no test waits for the disk.
    at = f"-h 127.0.0.1 -p {port} -k {folder} -c fsync=off -c full_page_writes=off"
    run("initdb", "-D", data, "-U", "app", "--auth=trust", "-E", "UTF8", "--no-sync")
    run("pg_ctl", "-D", data, "-w", "-l", log, "-o", at, "start")
    yield f"postgresql+psycopg://app@127.0.0.1:{port}"
    run("pg_ctl", "-D", data, "-w", "-m", "immediate", "stop")
    shutil.rmtree(folder)
