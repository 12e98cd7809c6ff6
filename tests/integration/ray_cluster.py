"""A Ray cluster of several nodes on this machine, which are killed and added."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from tests.needed import needed

# Read when Ray is imported: everything on the loopback, and nothing told to anyone.
os.environ.update(
    RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER="0",
    RAY_USAGE_STATS_ENABLED="0",
    RAY_raylet_start_wait_time_s="300",
)

QUICK: Final = {
    "health_check_initial_delay_ms": 5000,
    "health_check_period_ms": 1000,
    "health_check_timeout_ms": 3000,
    "health_check_failure_threshold": 3,
}
"""Lost nodes are noticed within seconds, and busy ones are not taken for lost."""

_MEMORY: Final = {"object_store_memory": 80 * 1024 * 1024}
_ROOT: Final = str(Path(__file__).resolve().parents[2])


class RayNodes:
    """A head without cores, and nodes that are killed and added.

    Attributes:
        address: Address of the cluster.
    """

    def __init__(self, nodes: int, environment: Mapping[str, str] | None = None) -> None:
        """Start the head and some nodes; `end` ends them.

        Args:
            nodes: Number of nodes, of two cores each.
            environment: Further variables of their processes, such as credentials of a bucket: an
                actor has those of its node, and none of the process that made it.
        """
        cluster_utils = needed("ray.cluster_utils", "the extra `ray`")
        self._before = dict(os.environ)
        os.environ.update(OMP_NUM_THREADS="1", PYTHONPATH=_ROOT)  # for the nodes' processes
        os.environ.update(environment or {})
        head = {"num_cpus": 0, "include_dashboard": False, "_system_config": QUICK}
        self._cluster = cluster_utils.Cluster(initialize_head=True, head_node_args=head | _MEMORY)
        self.address: str = self._cluster.address
        self._nodes: list[Any] = []
        for _ in range(nodes):
            self.add()

    def __len__(self) -> int:
        return len(self._nodes)

    def add(self) -> None:
        """Start one more node."""
        self._nodes.append(self._cluster.add_node(num_cpus=2, **_MEMORY))

    def kill(self, number: int = 0) -> None:
        """Kill a node with all its processes, by its place among those that run."""
        self._cluster.remove_node(self._nodes.pop(number), allow_graceful=False)

    def end(self) -> None:
        """End every node."""
        import ray

        ray.shutdown()
        self._cluster.shutdown()
        os.environ.clear()
        os.environ.update(self._before)


@contextmanager
def ray_nodes(nodes: int) -> Iterator[RayNodes]:
    """Start a cluster, and end it afterwards."""
    started = RayNodes(nodes)
    try:
        yield started
    finally:
        started.end()
