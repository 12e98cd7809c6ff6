"""The Ray pool on a cluster of three nodes, of which two are killed while it mines."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event

import pytest

from schemas.transport.bucket import open_bucket
from schemas.transport.bus import client_session, router_session
from schemas.transport.keys import DEFAULT_ROOT
from service.app import Service
from service.embedded import DRAINING
from service.settings.config import Settings
from service.store.engine import open_store
from service.store.ledger import LeasePolicy, Ledger
from tests.free_ports import free_endpoint
from tests.integration.conftest import SHARD_S, SHARDS, VEHICLES, Undisturbed
from tests.integration.daemons import Daemon
from tests.integration.ray_cluster import RayNodes, ray_nodes
from tests.needed import needed

needed("ray", "the extra `ray`")

from workers.pool.ray_pool import RayOptions, RayPool, wanted_size  # noqa: E402  # needs Ray

pytestmark = [pytest.mark.integration, pytest.mark.timeout(600)]

WORKERS = 3


def until(condition: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + 300.0
    while not condition():
        assert time.monotonic() < end_s, what
        Event().wait(0.05)


@pytest.fixture
def cluster() -> Iterator[RayNodes]:
    """A head without cores, and three nodes."""
    with ray_nodes(3) as nodes:
        yield nodes


def test_two_of_three_nodes_are_killed_and_all_scenes_are_those_of_a_local_run(
    tmp_path: Path, fleet: Path, undisturbed: dict[str, Undisturbed], cluster: RayNodes
) -> None:
    endpoint = free_endpoint()
    settings = Settings(
        bucket=str(fleet),
        artifacts=str(tmp_path / "overlays"),
        supervised="recorded",
        grid={"shard_s": SHARD_S},
        pictures="none",
    )
    (tmp_path / "state").mkdir()
    store = open_store(tmp_path / "state")
    ledger = Ledger(store, now_s=time.time, policy=LeasePolicy(lease_s=3.0, max_attempts=100))

    def done() -> int:
        return ledger.status().shards_by_state.get("done", 0)

    options = RayOptions(cluster.address, least=WORKERS, most=WORKERS, cpus=0.5)
    with (
        router_session([endpoint]),
        client_session([endpoint], stop=Event()) as session,
        Service(settings, session, ledger, bucket=open_bucket(str(fleet))),
        RayPool(options, connect=[endpoint], root=DEFAULT_ROOT, drain_s=2.0) as pool,
    ):
        until(lambda: pool.alive() == WORKERS and done() > 0, "workers on all nodes")
        for _ in range(2):
            cluster.kill()
        left = len(VEHICLES) * SHARDS - done()
        assert left > 0, "mined before a node was killed"
        until(lambda: done() == len(VEHICLES) * SHARDS, "every shard")
        until(lambda: pool.alive() == WORKERS, "all workers, on the node that is left")
        pool.check_ready()
        found = {scene.scene_id: scene.sha256 for scene in ledger.current_scenes()}
    store.close()
    expected: dict[str, str] = {}
    for each in undisturbed.values():
        expected |= each.records
    assert found == expected


@pytest.mark.parametrize(("backlog", "workers"), [(0, 2), (2, 2), (5, 5), (900, 8)])
def test_the_size_follows_the_backlog_between_its_bounds(backlog: int, workers: int) -> None:
    assert wanted_size(backlog, RayOptions(least=2, most=8)) == workers


def test_the_process_of_a_pool_drains_on_a_signal_and_ends_with_0(
    tmp_path: Path, cluster: RayNodes
) -> None:
    endpoint = free_endpoint()
    options = ("--pool", "ray", "--ray-address", cluster.address, "--connect", endpoint)
    pool = Daemon(tmp_path, "pool", "worker", "--workers", "1", *options)
    with router_session([endpoint]):
        pool.start()
        until(lambda: "1 workers on Ray" in pool.said(), "a pool")
        assert pool.stop() == 0, pool.said()
    assert DRAINING in pool.said()
