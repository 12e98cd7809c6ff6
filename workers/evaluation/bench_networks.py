"""Times the networks beside a plain transcription of their published forward pass, in pairs."""

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Final, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from schemas.bucket import Bucket
from schemas.work import MiningSettings, Recording
from workers.evaluation import published_forward
from workers.evaluation.floors import MS_PER_S
from workers.evaluation.whole_log import shards_of_log
from workers.geometry.range_image import SensorProfile
from workers.ingest.read import read_shard
from workers.memory import peak_memory_bytes
from workers.registry import build_odometry
from workers.selfsupervised.flowstep3d import FlowStep3D
from workers.supervised.classes import ClassMeaning
from workers.supervised.folded import FoldedSalsaNext
from workers.supervised.networks import run_eagerly
from workers.supervised.residual_image import ResidualSettings
from workers.supervised.stream import SHIPPED, RangeImageStream
from workers.supervised.weights import LoadedWeights, load_weights

FLOW_POINTS: Final = (8_192, 32_768, 100_000)
"""Sizes of cloud that FlowStep3D is timed at: of its training, four times that, a whole frame."""

_MIB: Final = 1 << 20
_SEED: Final = 1

Network = Literal["salsanext", "lmnet", "flowstep3d"]


class NetworkTime(BaseModel):
    """One way to run a network, beside the plain one."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    network: Network
    way: str = Field(description="`plain` is the published forward pass, eager, batch 1, float32.")
    size: str = Field(description="Of the image or the cloud.")
    median_ms: float
    faster: float = Field(description="Median over the rounds of plain's time over this one's.")
    changed: float | None = Field(
        default=None, description="Share of labels that differ from plain's; of flow, metres."
    )
    memory_mib: float | None = Field(
        default=None, description="Most held while running, beyond the process before it."
    )


@dataclass(slots=True)
class _Watched:
    """A network that keeps the images it is asked about."""

    weights: LoadedWeights
    images: list[NDArray[np.float32]] = field(default_factory=list)

    @property
    def profile(self) -> SensorProfile:
        return self.weights.profile

    @property
    def channels(self) -> tuple[str, ...]:
        return self.weights.channels

    @property
    def residual(self) -> ResidualSettings | None:
        return self.weights.residual

    @property
    def classes(self) -> tuple[ClassMeaning, ...]:
        return self.weights.classes

    @property
    def digest(self) -> str:
        return self.weights.digest

    def probabilities(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        self.images.append(image)
        return self.weights.probabilities(image)


def bench_images(
    bucket: Bucket,
    recording: Recording,
    settings: MiningSettings,
    *,
    frames: int,
    rounds: int = 3,
    clock: Callable[[], float] = time.perf_counter,
    on_progress: Callable[[str], None] = lambda what: None,
) -> Iterator[NetworkTime]:
    """Time the shipped SalsaNext and LMNet on the frames of a log, one thread.

    Each image runs through every way before the next one does, so that whatever slows the machine
    down slows all of them down.

    Args:
        bucket: Where the recording lies.
        recording: The log.
        settings: How the log is read, and which odometry gives the past of LMNet.
        frames: How many, after ten that fill the past.
        rounds: How often each image runs.
        clock: Seconds; `time.process_time` counts those of the processor.
        on_progress: Told what is being timed.

    Yields:
        A row per network and way.
    """
    semantic, motion = (
        _Watched(load_weights(SHIPPED / f"{name}.safetensors")) for name in ("salsanext", "lmnet")
    )
    shard, *_ = shards_of_log(bucket, recording, settings)
    read = read_shard(bucket, recording, shard, settings).frames()
    posed = islice(build_odometry(settings.odometry)(read), 10 + frames)
    for _ in RangeImageStream(semantic, motion, name="bench")(posed):
        pass
    names: tuple[tuple[Network, _Watched], ...] = (("salsanext", semantic), ("lmnet", motion))
    for name, watched in names:
        on_progress(name)
        yield from _timed_images(name, watched, frames=frames, rounds=rounds, clock=clock)


def _timed_images(
    name: Network, watched: _Watched, *, frames: int, rounds: int, clock: Callable[[], float]
) -> Iterator[NetworkTime]:
    net = watched.weights.net
    folded = FoldedSalsaNext(net)
    half = _in_bfloat16(watched.weights)
    ways: dict[str, Callable[[NDArray[np.float32]], Any]] = {
        "plain": lambda image: published_forward.salsanext(net, torch.from_numpy(image)[None]),
        "eager": lambda image: run_eagerly(net, image),
        "folded": lambda image: folded(torch.from_numpy(image)[None]),
        "bfloat16": half,
    }
    images = watched.images[-frames:]
    seconds, labels = _paired(ways, images * rounds, clock)
    height, width = images[0].shape[1:]
    for way in ways:
        differing = [
            float((one != plain).mean())
            for one, plain in zip(labels[way], labels["plain"], strict=True)
        ]
        yield NetworkTime(
            network=name,
            way=way,
            size=f"{height} x {width}",
            median_ms=statistics.median(seconds[way]) * MS_PER_S,
            faster=_faster(seconds["plain"], seconds[way]),
            changed=statistics.fmean(differing),
        )


def _in_bfloat16(weights: LoadedWeights) -> Callable[[NDArray[np.float32]], Tensor]:
    """Build the network anew in half the bits."""
    net = weights.card.build()
    net.load_state_dict(weights.net.state_dict())
    net = net.eval().bfloat16().to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def run(image: NDArray[np.float32]) -> Tensor:
        x = torch.from_numpy(image)[None].bfloat16()
        answer: Tensor = net(x.contiguous(memory_format=torch.channels_last))
        return answer.float()

    return run


def _paired(
    ways: dict[str, Callable[[NDArray[np.float32]], Any]],
    images: Sequence[NDArray[np.float32]],
    clock: Callable[[], float],
) -> tuple[dict[str, list[float]], dict[str, list[NDArray[np.intp]]]]:
    """Run every image every way; the first image once more before, to warm up."""
    torch.set_num_threads(1)
    seconds: dict[str, list[float]] = {way: [] for way in ways}
    labels: dict[str, list[NDArray[np.intp]]] = {way: [] for way in ways}
    for number, image in enumerate([images[0], *images]):
        for way, run in ways.items():
            with torch.inference_mode():
                start = clock()
                answer = run(image)
                took = clock() - start
            if number > 0:
                seconds[way].append(took)
                said = np.asarray(answer).reshape(-1, *image.shape[1:])
                labels[way].append(said[1:].argmax(axis=0))
    return seconds, labels


def _faster(plain: Sequence[float], other: Sequence[float]) -> float:
    return statistics.median(one / two for one, two in zip(plain, other, strict=True))


def bench_flow(
    points: int,
    *,
    rounds: int = 1,
    clock: Callable[[], float] = time.perf_counter,
) -> Iterator[NetworkTime]:
    """Time FlowStep3D on two made-up clouds, one thread; random weights, the times are the same.

    Args:
        points: Of each cloud.
        rounds: How often both ways run.
        clock: Seconds.

    Yields:
        The plain way and ours, with the memory that each needs in a process of its own.
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
            faster=_faster(seconds["plain"], seconds[way]),
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
    """Two clouds as wide as a filtered frame: walls, and things before them."""
    rng = np.random.default_rng(_SEED)
    clouds = []
    for _ in range(2):
        places = rng.uniform((-17.0, -1.5, 0.0), (17.0, 4.0, 35.0), size=(points, 3))
        places[: points // 2, 0] = np.where(places[: points // 2, 0] > 0, 9.0, -9.0)
        clouds.append(torch.from_numpy(places.astype(np.float32))[None])
    return clouds[0], clouds[1]


def _alone(way: str, points: int) -> float:
    """Memory of one way in a process of its own, MiB."""
    code = f"from workers.evaluation.bench_networks import hold; print(hold({way!r}, {points}))"
    ran = subprocess.run(  # noqa: S603  # ourselves
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    )
    return float(ran.stdout)


def hold(way: str, points: int) -> float:
    """Run FlowStep3D once; say how much more memory it took than was held before, MiB."""
    torch.set_num_threads(1)
    run, clouds = _flow_ways()[way], _street(points)
    before = peak_memory_bytes()
    with torch.inference_mode():
        run(*clouds)
    return (peak_memory_bytes() - before) / _MIB
