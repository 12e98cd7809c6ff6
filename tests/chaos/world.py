"""The system that chaos befalls: its processes, networks, clocks, bucket and database."""

import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Final

from sqlalchemy import create_engine, select

from schemas.transport.bucket import open_bucket
from service.settings.config import load_settings
from service.store.engine import Store, open_store
from service.store.opening import open_ledger_store_to_read
from service.store.tables import SCENES, WRITE_PROOF
from tests.chaos import small_disk
from tests.chaos.clocks import Clocks
from tests.chaos.fork_server import ForkServer
from tests.chaos.gateway import Gateway
from tests.chaos.parts import Parts
from tests.chaos.street_logs import OPTIONS, StreetLogs, Undisturbed
from tests.contracts.ledger_world import World, plan_of
from tests.integration.cutting_proxy import CuttingProxy
from tests.integration.postgres_server import Postgres
from tests.integration.quick_miner import SHARDS_PER_LOG
from tests.integration.ray_cluster import RayNodes
from tests.integration.standby_pair import ENVIRONMENT, Pair

SERVICES: Final = ("service-a", "service-b")
MINERS: Final = 3
WORKERS: Final = 2
NODES: Final = 2
"""Nodes of Ray at the start."""

LOGS: Final = 12
STREET_LOGS: Final = 4
"""Logs at the start; more come while there is time."""

_ENVIRONMENT: Final = ENVIRONMENT | {
    "COUNTERPOINT_LIST_INTERVAL_S": "1",
    "COUNTERPOINT_SETTLE_S": "0",
    "COUNTERPOINT_STANDBY_AFTER_S": "3",
    "COUNTERPOINT_MAX_ATTEMPTS": "100000",
    "COUNTERPOINT_WORKER_HTTP_LISTEN": "",
    "COUNTERPOINT_RAY_CPUS": "0.5",
}


class ChaosWorld:
    """Two services, two linked routers, miners and a PostgreSQL, with a network between them.

    Attributes:
        parts: Its further parts.
        pair: The processes.
        networks: Proxies by name: of each service to the database, of all clients to each router,
            of all processes to the gateway.
        postgres: The database.
        has_small_disk: True if the database lies on a small file system of its own.
        clocks: Clocks of the processes; None: they have the one of the machine.
        gateway: The S3 gateway; None: logs lie in a folder.
        nodes: Nodes of Ray; None: there is no such pool.
    """

    def __init__(self, folder: Path, opened: ExitStack, *, parts: Parts, seed: int) -> None:
        """Start database, gateway and nodes; the processes of `pair` are started later.

        Args:
            folder: For everything.
            opened: Ends everything.
            parts: Further parts.
            seed: Of the clocks at the start.
        """
        self._folder, self._data, self.parts = folder, folder / "postgres", parts
        self._data.mkdir()
        self.has_small_disk = small_disk.mount(self._data)
        if self.has_small_disk:
            opened.callback(small_disk.unmount, self._data)
        self.postgres = Postgres(self._data)
        self.postgres.set_small()
        self.postgres.start()
        opened.callback(self.stop_postgres)
        self.networks: dict[str, CuttingProxy] = {}
        databases = {name: self._through(opened, name) for name in SERVICES}
        self.clocks = Clocks(folder / "clocks", seed=seed) if parts.clocks else None
        self.gateway = Gateway(opened) if parts.gateway else None
        aws = {} if self.gateway is None else self.gateway.environment
        self.nodes = RayNodes(NODES, aws) if parts.pool == "ray" else None
        if self.nodes is not None:
            opened.callback(self.nodes.end)
        self._streets = None if parts.pool == "quick" else self._street_logs()
        routers = iter(("router 0", "router 1"))

        def through(endpoint: str) -> str:
            proxy = opened.enter_context(CuttingProxy(int(endpoint.rpartition(":")[2])))
            self.networks[next(routers)] = proxy
            return f"tcp/127.0.0.1:{proxy.port}"

        server = opened.enter_context(ForkServer(self._variables_of("processes")))
        self.pair = Pair(
            folder,
            databases=databases,
            logs=LOGS if self._streets is None else STREET_LOGS,
            miners=MINERS if self._streets is None else 0,
            routers=2,
            logs_in=self._streets,
            service_options=() if self._streets is None else OPTIONS,
            pools=self._pools(),
            variables_of=self._variables_of,
            through=through,
            environment=_ENVIRONMENT | aws,
            spawn=server.spawn,
        )
        opened.callback(self.pair.end)

    def _through(self, opened: ExitStack, service: str) -> str:
        """Return the URL of the database through a network of its own."""
        proxy = opened.enter_context(CuttingProxy(self.postgres.port))
        self.networks[f"{service} to database"] = proxy
        return self.postgres.url.replace(f":{self.postgres.port}/", f":{proxy.port}/")

    def _street_logs(self) -> StreetLogs:
        made = self._folder / "made"
        if self.gateway is None:
            logs, overlays = (
                open_bucket(str(self._folder / name), create=True) for name in ("logs", "overlays")
            )
            return StreetLogs(made, logs=logs, overlays=overlays)
        self.networks["gateway"] = self.gateway.network
        gateway = self.gateway
        return StreetLogs(
            made, logs=gateway.open(gateway.logs), overlays=gateway.open(gateway.overlays)
        )

    def _pools(self) -> dict[str, tuple[str, ...]]:
        if self._streets is None:
            return {}
        workers = ("--workers", str(WORKERS))
        if self.nodes is None:
            return {"pool": workers}
        return {"pool": ("--pool", "ray", "--ray-address", self.nodes.address, *workers)}

    def _variables_of(self, name: str) -> dict[str, str]:
        return {} if self.clocks is None else self.clocks.variables_of(name)

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
        small_disk.fill(self._data)

    def empty_disk(self) -> None:
        """Delete what filled the disk, and start a server that it has ended."""
        small_disk.empty(self._data)
        self.ensure_postgres()

    def stored(self) -> dict[str, bytes]:
        """Return every stored record by its scene, read from the database itself.

        Raises:
            AssertionError: If a scene is stored twice.
        """
        with self._reading() as store:
            return records_of(store)

    def term(self) -> int:
        """Return how often the database was opened for writing."""
        with self._reading() as store, store.reading() as connection:
            return int(connection.execute(select(WRITE_PROOF.c.term)).scalar_one())

    def undisturbed(self) -> Undisturbed:
        """Mine the same logs in one process that nothing disturbs."""
        if self._streets is not None:
            return self._streets.undisturbed()
        with (
            tempfile.TemporaryDirectory(dir=self._folder) as folder,
            closing(open_store(Path(folder))) as store,
        ):
            world = World.on(
                store, planner=lambda found: plan_of(found.log_id, shards=SHARDS_PER_LOG)
            )
            world.listed(*self.pair.log_ids)
            world.mine_all()
            return Undisturbed(records_of(store))

    def wrong_overlays(self, expected: Undisturbed) -> list[str]:
        """Return the keys of the overlays that are missing or differ."""
        return [] if self._streets is None else self._streets.wrong_overlays(expected.overlays)

    @contextmanager
    def _reading(self) -> Iterator[Store]:
        settings = load_settings(database=self.postgres.url, state=self._folder)
        with closing(open_ledger_store_to_read(settings)) as store:
            yield store

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
def chaos_world(parts: Parts, *, seed: int) -> Iterator[ChaosWorld]:
    """Build the system in a folder of its own; end and delete everything afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="chaos-"))
    folder.chmod(0o755)  # PostgreSQL runs as a user of its own
    try:
        with ExitStack() as opened:
            yield ChaosWorld(folder, opened, parts=parts, seed=seed)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
