"""The Ray pool on a cluster of three nodes, of which two are killed while it mines."""

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event
from typing import Any

import pytest

from schemas.transport.bucket import open_bucket
from schemas.transport.bus import client_session, router_session
from schemas.transport.keys import DEFAULT_ROOT
from service.app import Service
from service.settings.config import Settings
from service.store.engine import open_store
from service.store.ledger import LeasePolicy, Ledger
from tests.free_ports import free_endpoint
from tests.integration.conftest import SHARD_S, SHARDS, VEHICLES, Undisturbed
from tests.needed import needed

# Read when Ray is imported: everything on the loopback, and nothing told to anyone.
os.environ.update(
    RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER="0",
    RAY_USAGE_STATS_ENABLED="0",
    RAY_raylet_start_wait_time_s="300",
)

cluster_utils = needed("ray.cluster_utils", "the extra `ray`")

from workers.pool.ray_pool import RayOptions, RayPool, wanted_size  # noqa: E402  # needs Ray

pytestmark = [pytest.mark.integration, pytest.mark.timeout(600)]

QUICK = {
    "health_check_initial_delay_ms": 5000,
    "health_check_period_ms": 1000,
    "health_check_timeout_ms": 3000,
    "health_check_failure_threshold": 3,
}
"""Lost nodes are noticed within seconds, and busy ones are not taken for lost."""

NODE = {"num_cpus": 2, "object_store_memory": 80 * 1024 * 1024}
WORKERS = 3


def until(condition: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + 300.0
    while not condition():
        assert time.monotonic() < end_s, what
        Event().wait(0.05)


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A head without cores, and three nodes."""
    import ray

    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    made = cluster_utils.Cluster(
        initialize_head=True,
        head_node_args={
            "num_cpus": 0,
            "include_dashboard": False,
            "object_store_memory": 80 * 1024 * 1024,
            "_system_config": QUICK,
        },
    )
    made.workers = [made.add_node(**NODE) for _ in range(3)]
    try:
        yield made
    finally:
        ray.shutdown()
        made.shutdown()


def test_two_of_three_nodes_are_killed_and_all_scenes_are_those_of_a_local_run(
    tmp_path: Path, fleet: Path, undisturbed: dict[str, Undisturbed], cluster: Any
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
        for node in cluster.workers[:2]:
            cluster.remove_node(node, allow_graceful=False)
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
