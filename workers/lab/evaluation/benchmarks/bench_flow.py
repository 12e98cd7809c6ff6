"""FlowStep3D benchmark: paired times against a transcription of the published forward pass."""

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
import torch
from torch import Tensor

from workers.lab.evaluation.benchmarks import published_forward
from workers.lab.evaluation.benchmarks.lower_bounds import MS_PER_S
from workers.lab.evaluation.benchmarks.network_time import NetworkTime, times_as_fast
from workers.memory import peak_memory_bytes
from workers.paper.flowstep3d import FlowStep3D

FLOW_POINTS: Final = (8_192, 32_768, 100_000)
"""Cloud sizes of the benchmark, points: the training size, four times that, a whole frame."""

_MIB: Final = 1 << 20
_SEED: Final = 1


def bench_flow(
    points: int,
    *,
    rounds: int = 1,
    clock: Callable[[], float] = time.perf_counter,
) -> Iterator[NetworkTime]:
    """Time FlowStep3D on two synthetic clouds with random weights, one thread.

    Args:
        points: Points of each cloud.
        rounds: Number of runs of both implementations.
        clock: Returns seconds.

    Yields:
        The plain implementation and ours, with the memory of each in its own process.
    """
    torch.set_num_threads(1)
    ways = _flow_ways()
    clouds = _street(points)
    seconds: dict[str, list[float]] = {way: [] for way in ways}
    flows: dict[str, Tensor] = {}
    for _ in range(rounds):
        for way, run in ways.items():
            with torch.inference_mode():
                start = clock()
                flows[way] = run(*clouds)
                seconds[way].append(clock() - start)
    for way in ways:
        yield NetworkTime(
            network="flowstep3d",
            way=way,
            size=f"{points} points",
            median_ms=statistics.median(seconds[way]) * MS_PER_S,
            faster=times_as_fast(seconds["plain"], seconds[way]),
            changed=float((flows[way] - flows["plain"]).abs().max()),
            memory_mib=_alone(way, points),
        )


def _flow_ways() -> dict[str, Callable[[Tensor, Tensor], Tensor]]:
    torch.manual_seed(_SEED)
    net = FlowStep3D().eval()
    return {
        "plain": lambda cloud, then: published_forward.flowstep3d(net, cloud, then),
        "ours": lambda cloud, then: net(cloud, then)[-1],
    }


def _street(points: int) -> tuple[Tensor, Tensor]:
    """Build two clouds as wide as a filtered frame: walls, and objects before them."""
    rng = np.random.default_rng(_SEED)
    clouds = []
    for _ in range(2):
        places = rng.uniform((-17.0, -1.5, 0.0), (17.0, 4.0, 35.0), size=(points, 3))
        places[: points // 2, 0] = np.where(places[: points // 2, 0] > 0, 9.0, -9.0)
        clouds.append(torch.from_numpy(places.astype(np.float32))[None])
    return clouds[0], clouds[1]


def _alone(way: str, points: int) -> float:
    """Measure the memory of one implementation in its own process, MiB."""
    module = "workers.lab.evaluation.benchmarks.bench_flow"
    code = f"from {module} import hold; print(hold({way!r}, {points}))"
    ran = subprocess.run(  # noqa: S603  # ourselves
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    )
    return float(ran.stdout)


def hold(way: str, points: int) -> float:
    """Run FlowStep3D once, and return the additional peak memory, MiB."""
    torch.set_num_threads(1)
    run, clouds = _flow_ways()[way], _street(points)
    before = peak_memory_bytes()
    with torch.inference_mode():
        run(*clouds)
    return (peak_memory_bytes() - before) / _MIB
