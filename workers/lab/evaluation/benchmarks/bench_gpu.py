"""GPU benchmark: frames per second of the supervised stream, and its labels against the CPU's."""

import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from itertools import islice
from threading import Event
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.frame import PosedFrame
from schemas.labels import FrameLabels
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from schemas.work import Recording
from workers.checkpoints.devices import Device, device_of
from workers.ingest.read import read_shard
from workers.lab.evaluation.benchmarks.recording_network import RecordingNetwork
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.parts.registry import build_odometry
from workers.supervised.networks import FRAMES_TOGETHER, answers_of
from workers.supervised.stream import SHIPPED, RangeImageStream
from workers.supervised.weights import load_weights

_NETWORKS: Final = ("salsanext", "lmnet")
_SAMPLE_S: Final = 0.05


class DeviceSpeed(BaseModel):
    """Speed of both networks, and of the supervised stream around them, on one device."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    device: str = Field(description="Name of the GPU, or `cpu`: one thread.")
    together: int = Field(description="Frames that the networks run over at once.")
    networks_per_s: float = Field(description="Frames per second through both networks alone.")
    stream_per_s: float = Field(description="Frames per second of the stream, in one process.")
    busy: float | None = Field(description="Mean utilisation of the GPU while networks run alone.")


class GpuBench(BaseModel):
    """Both devices, and how far their labels agree."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    log: str
    frames: int
    points: int = Field(description="Points of these frames.")
    speeds: tuple[DeviceSpeed, ...]
    same_labels: float = Field(description="Share of points with the same label on both.")
    same_classes: float = Field(description="Share of points with the same class on both.")


def bench_gpu(
    bucket: Bucket,
    recording: Recording,
    settings: MiningSettings,
    *,
    frames: int,
    seconds: float,
    on_progress: Callable[[str], None] = lambda what: None,
) -> GpuBench:
    """Run the shipped networks and the supervised stream on the CPU and on the GPU.

    Args:
        bucket: Bucket of the recording.
        recording: The log.
        settings: Ingest settings, and the odometry that poses the past frames of LMNet.
        frames: Number of frames, from the start of the log.
        seconds: Duration of each measurement: the frames are repeated until then.
        on_progress: Called with what is measured.

    Raises:
        WeightsUnusableError: If torch finds no GPU of CUDA.
    """
    gpu = device_of("cuda")
    shard, *_ = shards_of_log(bucket, recording, settings)
    read = read_shard(bucket, recording, shard, settings).frames()
    posed = list(islice(build_odometry(settings.odometry)(read), frames))
    speeds: list[DeviceSpeed] = []
    labels: list[list[FrameLabels]] = []
    devices: tuple[Device, ...] = ("cpu", gpu)
    for device in devices:
        on_progress(device)
        stream = RangeImageStream.salsanext_lmnet(SHIPPED, device=device)
        labels.append(list(stream(posed)))  # the first run also loads kernels
        per_s = len(posed) / _median_s(partial(_consume, stream, posed), seconds)
        speeds.append(_with_networks(device, posed, seconds, stream_per_s=per_s))
    return GpuBench(
        log=recording.log_id,
        frames=len(posed),
        points=sum(len(each.frame) for each in posed),
        speeds=tuple(speeds),
        same_labels=_equal(*([each.labels for each in one] for one in labels)),
        same_classes=_equal(
            *([each.class_id for each in one if each.class_id is not None] for one in labels)
        ),
    )


def _with_networks(
    device: Device, posed: Sequence[PosedFrame], seconds: float, *, stream_per_s: float
) -> DeviceSpeed:
    """Time both networks on the images that the stream makes of these frames."""
    networks = [
        load_weights(SHIPPED / f"{name}.safetensors", folded=True, device=device)
        for name in _NETWORKS
    ]
    watched = [RecordingNetwork(each) for each in networks]
    for _ in RangeImageStream(*watched, name="bench")(posed):
        pass
    together = FRAMES_TOGETHER[device]

    def run() -> None:
        for network, recorded in zip(networks, watched, strict=True):
            for first in range(0, len(posed), together):
                answers_of(network, recorded.images[first : first + together])

    run()
    with _utilisation(device) as busy:
        took_s = _median_s(run, seconds)
    return DeviceSpeed(
        device="cpu" if device == "cpu" else torch.cuda.get_device_name(),
        together=together,
        networks_per_s=len(posed) / took_s,
        stream_per_s=stream_per_s,
        busy=statistics.fmean(busy) / 100 if busy else None,
    )


def _median_s(run: Callable[[], object], seconds: float) -> float:
    """Return the median time of a run, repeated for some seconds."""
    found: list[float] = []
    while sum(found) < seconds:
        start = time.perf_counter()
        run()
        found.append(time.perf_counter() - start)
    return statistics.median(found)


@contextmanager
def _utilisation(device: Device) -> Iterator[list[int]]:
    """Sample the utilisation of the GPU, percent, while the block runs; nothing on the CPU.

    The driver's library is asked through `nvidia-ml-py`; without it there are no samples.
    """
    found: list[int] = []
    ended = Event()

    def sample() -> None:
        try:
            while not ended.wait(_SAMPLE_S):
                found.append(torch.cuda.utilization())
        except ModuleNotFoundError:
            return

    if device == "cpu":
        yield found
        return
    with ThreadPoolExecutor(1) as pool:
        sampling = pool.submit(sample)
        try:
            yield found
        finally:
            ended.set()
        sampling.result()


def _consume(stream: RangeImageStream, posed: Sequence[PosedFrame]) -> None:
    for _ in stream(posed):
        pass


def _equal(one: Sequence[NDArray[np.integer]], other: Sequence[NDArray[np.integer]]) -> float:
    return float((np.concatenate(one) == np.concatenate(other)).mean())
