"""The system that chaos befalls: its processes, its networks, and its database on a small disk."""

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Final

from sqlalchemy import create_engine, select

from service.settings.config import load_settings
from service.store.engine import Store, open_store
from service.store.opening import open_ledger_store_to_read
from service.store.tables import SCENES, WRITE_PROOF
from tests.chaos.fork_server import ForkServer
from tests.contracts.ledger_world import World, plan_of
from tests.integration.cutting_proxy import CuttingProxy
from tests.integration.postgres_server import Postgres
from tests.integration.quick_miner import SHARDS_PER_LOG
from tests.integration.standby_pair import ENVIRONMENT, Pair

SERVICES: Final = ("service-a", "service-b")
MINERS: Final = 3
LOGS: Final = 12
"""Logs at the start; more come while there is time."""

DISK_MB: Final = 160
"""Size of the disk of the database, where a file system may be mounted."""

_ENVIRONMENT: Final = ENVIRONMENT | {
    "COUNTERPOINT_LIST_INTERVAL_S": "1",
    "COUNTERPOINT_SETTLE_S": "0",
    "COUNTERPOINT_STANDBY_AFTER_S": "3",
    "COUNTERPOINT_MAX_ATTEMPTS": "100000",
}


class ChaosWorld:
    """Two services, two linked routers, miners and a PostgreSQL, with a network between them.

    Attributes:
        pair: The processes.
        networks: Proxies by name: of each service to the database, of all clients to each router.
        postgres: The database.
        has_small_disk: True if the database lies on a small file system of its own.
    """

    def __init__(self, folder: Path, opened: ExitStack) -> None:
        """Start the database; `start` starts the rest.

        Args:
            folder: For everything.
            opened: Ends everything.
        """
        self._folder = folder
        data = folder / "postgres"
        data.mkdir()
        self.has_small_disk = _mount(data)
        if self.has_small_disk:
            opened.callback(_unmount, data)
        self.postgres = Postgres(data)
        self.postgres.set_small()
        self.postgres.start()
        opened.callback(self.stop_postgres)
        self.networks: dict[str, CuttingProxy] = {}
        databases = {}
        for name in SERVICES:
            proxy = self.networks[f"{name} to database"] = opened.enter_context(
                CuttingProxy(self.postgres.port)
            )
            port = f":{self.postgres.port}/"
            databases[name] = self.postgres.url.replace(port, f":{proxy.port}/")

        def through(endpoint: str) -> str:
            proxy = opened.enter_context(CuttingProxy(int(endpoint.rpartition(":")[2])))
            self.networks[f"router {len(self.networks) - len(SERVICES)}"] = proxy
            return f"tcp/127.0.0.1:{proxy.port}"

        server = opened.enter_context(ForkServer())
        self.pair = Pair(
            folder,
            databases=databases,
            logs=LOGS,
            miners=MINERS,
            routers=2,
            through=through,
            environment=_ENVIRONMENT,
            spawn=server.spawn,
        )
        opened.callback(self.pair.end)

    def stop_postgres(self) -> None:
        """End the server as a crash does, if it runs."""
        with suppress(subprocess.CalledProcessError):  # a full disk has ended it
            self.postgres.stop()

    def ensure_postgres(self) -> None:
        """Start the server if it does not answer; a crashed one needs a moment to leave."""
        end_s = time.monotonic() + 60
        while not self._postgres_answers():
            assert time.monotonic() < end_s, "PostgreSQL does not start again"
            try:
                self.postgres.start()
            except subprocess.CalledProcessError:
                time.sleep(0.3)

    def fill_disk(self) -> None:
        """Write until the disk of the database is full."""
        with (self._folder / "postgres" / "filler").open("wb", buffering=0) as file:
            try:
                while True:
                    file.write(bytes(1 << 20))
            except OSError:
                return

    def empty_disk(self) -> None:
        """Delete what filled the disk, and start a server that it has ended."""
        (self._folder / "postgres" / "filler").unlink(missing_ok=True)
        self.ensure_postgres()

    def stored(self) -> dict[str, bytes]:
        """Return every stored record by its scene, read from the database itself.

        Raises:
            AssertionError: If a scene is stored twice.
        """
        settings = load_settings(database=self.postgres.url, state=self._folder)
        with closing(open_ledger_store_to_read(settings)) as store:
            return records_of(store)

    def term(self) -> int:
        """Return how often the database was opened for writing."""
        settings = load_settings(database=self.postgres.url, state=self._folder)
        with (
            closing(open_ledger_store_to_read(settings)) as store,
            store.reading() as connection,
        ):
            return int(connection.execute(select(WRITE_PROOF.c.term)).scalar_one())

    def undisturbed(self) -> dict[str, bytes]:
        """Mine the same logs in one process that nothing disturbs; return its records by scene."""
        with (
            tempfile.TemporaryDirectory(dir=self._folder) as folder,
            closing(open_store(Path(folder))) as store,
        ):
            world = World.on(
                store, planner=lambda found: plan_of(found.log_id, shards=SHARDS_PER_LOG)
            )
            world.listed(*self.pair.log_ids)
            world.mine_all()
            return records_of(store)

    def _postgres_answers(self) -> bool:
        engine = create_engine(self.postgres.url, connect_args={"connect_timeout": 3})
        try:
            with engine.connect():
                return True
        except Exception:  # noqa: BLE001  # away, starting, or without room
            return False
        finally:
            engine.dispose()


def records_of(store: Store) -> dict[str, bytes]:
    """Return every stored record of a database by its scene; a scene may be there once only."""
    with store.reading() as connection:
        rows = connection.execute(select(SCENES.c.scene_id, SCENES.c.record)).all()
    found = {scene_id: bytes(record) for scene_id, record in rows}
    assert len(found) == len(rows), f"{len(rows) - len(found)} scenes are stored twice"
    return found


@contextmanager
def chaos_world() -> Iterator[ChaosWorld]:
    """Build the system in a folder of its own; end and delete everything afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="chaos-"))
    folder.chmod(0o755)  # PostgreSQL runs as a user of its own
    try:
        with ExitStack() as opened:
            yield ChaosWorld(folder, opened)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _mount(point: Path) -> bool:
    """Mount a small file system in memory; return false if that is not allowed."""
    if os.geteuid() != 0:
        return False
    size = f"size={DISK_MB}m"
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", size, "none", point], capture_output=True)
    return done.returncode == 0


def _unmount(point: Path) -> None:
    subprocess.run(["umount", "--lazy", point], check=True)
