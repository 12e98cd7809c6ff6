"""A PostgreSQL of a test's own, on a free port of the loopback."""

import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from sqlalchemy import create_engine, text

from tests.needed import needed


class Postgres:
    """A server of the test's own, which can be restarted."""

    def __init__(self, folder: Path) -> None:
        needed("psycopg", "the extra `postgres`")
        programs = sorted(Path("/usr/lib/postgresql").glob("*/bin"))
        if not programs:
            pytest.skip("needs Debian's package `postgresql`")
        self._bin, self._folder = programs[-1], folder
        self._as: tuple[str, ...] = ()
        if os.geteuid() == 0:  # PostgreSQL refuses to run as root
            shutil.chown(folder, "postgres", "postgres")
            self._as = ("setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups")
        with socket.create_server(("127.0.0.1", 0)) as probe:
            self.port = probe.getsockname()[1]
        self.url = f"postgresql+psycopg://app@127.0.0.1:{self.port}/postgres"
        self._do("initdb", "-D", self._data, "-U", "app", "--auth=trust", "-E", "UTF8", "--no-sync")

    @property
    def _data(self) -> str:
        return str(self._folder / "data")

    def set_small(self) -> None:
        """Keep the files of its journal few, for a small disk."""
        with (Path(self._data) / "postgresql.auto.conf").open("a") as file:
            file.write("max_wal_size = 48MB\nmin_wal_size = 32MB\nshared_buffers = 16MB\n")

    def start(self) -> None:
        options = f"-h 127.0.0.1 -p {self.port} -k {self._folder}"
        log = str(self._folder / "log")
        self._do("pg_ctl", "-D", self._data, "-w", "-l", log, "-o", options, "start")

    def stop(self) -> None:
        self._do("pg_ctl", "-D", self._data, "-w", "-m", "immediate", "stop")

    def ask_for_passwords(self) -> None:
        """Require a password of every later login."""
        hba = Path(self._data) / "pg_hba.conf"
        hba.write_text("host all all 127.0.0.1/32 scram-sha-256\n")
        self._do("pg_ctl", "-D", self._data, "reload")

    def set(self, name: str, value: str) -> None:
        """Change a setting for every session, from its next transaction on."""
        with (Path(self._data) / "postgresql.auto.conf").open("a") as file:
            file.write(f"{name} = {value}\n")
        self._do("pg_ctl", "-D", self._data, "reload")
        engine = create_engine(self.url)
        shown = text(f"SHOW {name}")
        end_s = time.monotonic() + 60
        while True:
            with engine.connect() as connection:
                if connection.execute(shown).scalar_one() == value:
                    break
            assert time.monotonic() < end_s, f"{name} is not {value}"
            time.sleep(0.05)
        engine.dispose()

    def _do(self, program: str, *arguments: str) -> None:
        subprocess.run(
            [*self._as, str(self._bin / program), *arguments],
            check=True,
            timeout=60,
            cwd=self._folder,
            stdout=subprocess.DEVNULL,
        )


@contextmanager
def postgres_server() -> Iterator[Postgres]:
    """Start a server in a folder of its own; stop it and delete the folder at the end."""
    folder = Path(tempfile.mkdtemp(prefix="postgres-"))
    try:
        server = Postgres(folder)
        server.start()
        yield server
        server.stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
