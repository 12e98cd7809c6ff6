"""Network benchmark: paired times against a transcription of the published forward passes."""

import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from schemas.work import Recording
from workers.ingest.read import read_shard
from workers.lab.evaluation.benchmarks import published_forward
from workers.lab.evaluation.benchmarks.lower_bounds import MS_PER_S
from workers.lab.evaluation.benchmarks.network_time import Network, NetworkTime, times_as_fast
from workers.lab.evaluation.benchmarks.recording_network import RecordingNetwork
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.parts.registry import build_odometry
from workers.supervised.folded import FoldedSalsaNext
from workers.supervised.networks import run_network
from workers.supervised.stream import SHIPPED, RangeImageStream
from workers.supervised.weights import LoadedWeights, load_weights

BATCH: Final = 4
BATCHED: Final = f"folded, {BATCH} frames at once"
"""Name of the batched run. Its time is per frame; labels would wait for the last of them."""

THREADS: Final = 2
THREADED: Final = f"folded, {THREADS} threads"


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

    Each image runs through every implementation before the next one does, so that slowdowns of the
    machine affect all of them.

    Args:
        bucket: Bucket of the recording.
        recording: The log.
        settings: Ingest settings, and the odometry that poses the past frames of LMNet.
        frames: Number of frames, after ten that fill the past.
        rounds: Number of runs of each image.
        clock: Returns seconds; `time.process_time` counts those of the processor.
        on_progress: Called with the name of the network.

    Yields:
        A row per network and implementation.
    """
    semantic, motion = (
        RecordingNetwork(load_weights(SHIPPED / f"{name}.safetensors"))
        for name in ("salsanext", "lmnet")
    )
    shard, *_ = shards_of_log(bucket, recording, settings)
    read = read_shard(bucket, recording, shard, settings).frames()
    posed = islice(build_odometry(settings.odometry)(read), 10 + frames)
    for _ in RangeImageStream(semantic, motion, name="bench")(posed):
        pass
    names: tuple[tuple[Network, RecordingNetwork], ...] = (
        ("salsanext", semantic),
        ("lmnet", motion),
    )
    for name, watched in names:
        on_progress(name)
        yield from _timed_images(name, watched, frames=frames, rounds=rounds, clock=clock)


def _timed_images(
    name: Network,
    watched: RecordingNetwork,
    *,
    frames: int,
    rounds: int,
    clock: Callable[[], float],
) -> Iterator[NetworkTime]:
    net = watched.weights.net
    folded = FoldedSalsaNext(net)
    half = _in_bfloat16(watched.weights)
    ways: dict[str, Callable[[NDArray[np.float32]], Any]] = {
        "plain": lambda image: published_forward.salsanext(net, torch.from_numpy(image)[None]),
        "eager": lambda image: run_network(net, image[None], "cpu")[0],
        "folded": lambda image: folded(torch.from_numpy(image)[None]),
        BATCHED: lambda image: folded(torch.from_numpy(np.stack([image] * BATCH))),
        THREADED: lambda image: folded(torch.from_numpy(image)[None]),
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
            faster=times_as_fast(seconds["plain"], seconds[way]),
            changed=statistics.fmean(differing),
        )


def _in_bfloat16(weights: LoadedWeights) -> Callable[[NDArray[np.float32]], Tensor]:
    """Build a copy of the network in bfloat16."""
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
    """Run every image on every implementation; one additional run of the first image warms up."""
    seconds: dict[str, list[float]] = {way: [] for way in ways}
    labels: dict[str, list[NDArray[np.intp]]] = {way: [] for way in ways}
    for number, image in enumerate([images[0], *images]):
        for way, run in ways.items():
            torch.set_num_threads(THREADS if way == THREADED else 1)
            with torch.inference_mode():
                start = clock()
                answer = run(image)
                took = clock() - start
            if number > 0:
                seconds[way].append(took / (BATCH if way == BATCHED else 1))
                scores = np.asarray(answer)
                scores = scores[0] if scores.ndim == 4 else scores
                labels[way].append(scores[1:].argmax(axis=0))
    torch.set_num_threads(1)
    return seconds, labels
