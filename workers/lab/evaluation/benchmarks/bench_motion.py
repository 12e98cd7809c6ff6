"""Self-supervised stream profile: time per step and frame, with its lower bounds."""

import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager
from itertools import islice, tee
from multiprocessing import get_context
from typing import Final, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket, open_bucket
from schemas.work import Recording
from workers.errors import LogUnusableError
from workers.ingest.read import read_shard
from workers.lab.evaluation.benchmarks.lower_bounds import MS_PER_S, kiss_icp_ms, patchwork_ms
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.memory import peak_memory_bytes
from workers.parts.registry import build_parts
from workers.points.step_names import watched
from workers.stage_timing import StageClock, timed

STREAM: Final = "selfsupervised"
KISS: Final = "kiss-icp alone"
PATCHWORK: Final = "patchwork++ alone"
_BEFORE_THE_STREAM: Final = ("ingest", "odometry")
_MIB: Final = 1 << 20

_OWN_MEMORY: Final = "from workers.memory import peak_memory_bytes; print(peak_memory_bytes())"


class StepTime(BaseModel):
    """Time of one step per frame."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    part: str = Field(description="`selfsupervised` is the whole stream, `…: x` a step of it.")
    median_ms: float
    p95_ms: float
    mean_ms: float


class MotionBench(BaseModel):
    """Time of the stream compared with that of its two libraries alone."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    log: str
    frames: int = Field(ge=1, description="Frames that were timed.")
    points: int = Field(description="Median number of points of a frame.")
    parts: tuple[StepTime, ...]
    ratio: float = Field(
        description="Median of the stream without odometry over that of both libraries."
    )
    ratio_with_odometry: float
    memory_mib: float = Field(
        description="Peak memory of a process that reads the log and labels it, "
        "minus an idle interpreter: with libraries, after compilation of the loops."
    )


def bench_motion(
    bucket: Bucket,
    recording: Recording,
    settings: MiningSettings,
    *,
    frames: tuple[int, int | None] = (0, None),
    clock: Callable[[], float] = time.perf_counter,
    on_progress: Callable[[int], None] = lambda done: None,
) -> MotionBench:
    """Time the steps of the self-supervised stream, KISS-ICP and Patchwork++.

    Each frame runs through odometry, the stream and both libraries before the next is read, so that
    slowdowns of the machine affect all of them.

    Args:
        bucket: Bucket of the recording.
        recording: The log, from its first frame on.
        settings: Names of the parts, and ingest settings.
        frames: First timed frame and the end, exclusive (None: the rest); earlier frames run
            untimed.
        clock: Returns seconds: wall time, or processor time on a shared machine.
        on_progress: Called with the number of frames done.

    Raises:
        LogUnusableError: If the log cannot be mined, or has no frame in the range.
    """
    first, stop = frames
    shard, *_ = shards_of_log(bucket, recording, settings)
    parts = build_parts(
        odometry=settings.odometry,
        # not run: this part loads nothing, so it needs no memory
        supervised="recorded",
        selfsupervised=settings.selfsupervised,
    )
    watch = StageClock(clock)
    given = watch.drawn("ingest", read_shard(bucket, recording, shard, settings).frames())
    own, for_kiss, for_patchwork = tee(islice(given, stop), 3)
    run = timed(parts, watch)
    floors = {KISS: kiss_icp_ms(for_kiss, clock), PATCHWORK: patchwork_ms(for_patchwork, clock)}
    rows: list[dict[str, float]] = []
    points: list[int] = []
    # steps are stages to the clock, with names of their own
    stages = cast(Callable[[str], AbstractContextManager[None]], watch.stage)
    before: Mapping[str, float] = {}
    answers = run.selfsupervised(run.odometry(own))
    while True:
        # the lower bounds run the same steps, which must not be timed as the stream's
        with watched(stages):
            labels = next(answers, None)
        if labels is None:
            break
        row, before = _since(before, watch)
        row |= {name: next(floor) for name, floor in floors.items()}
        rows.append(row)
        points.append(len(labels.labels))
        on_progress(len(rows))
    if len(rows) <= first:
        raise LogUnusableError(
            f"cannot time {recording.log_id}: it has {len(rows)} frames, none from {first} on"
        )
    times = {row.part: row for row in _times(rows[first:])}
    floor_ms = times[KISS].median_ms + times[PATCHWORK].median_ms
    stream_ms = times[STREAM].median_ms
    return MotionBench(
        log=recording.log_id,
        frames=len(rows) - first,
        points=int(np.median(points[first:])),
        parts=tuple(times.values()),
        ratio=round(stream_ms / floor_ms, 3),
        ratio_with_odometry=round((stream_ms + times["odometry"].median_ms) / floor_ms, 3),
        memory_mib=round((_alone(bucket, recording, settings, stop) - _idle_bytes()) / _MIB, 1),
    )


def _alone(bucket: Bucket, recording: Recording, settings: MiningSettings, stop: int | None) -> int:
    """Measure the peak memory of odometry and stream in their own process."""
    with ProcessPoolExecutor(max_workers=1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_labelled, bucket.url, recording, settings, stop).result()


def _labelled(url: str, recording: Recording, settings: MiningSettings, stop: int | None) -> int:
    """Label the first frames of a log, and return the peak memory of this process."""
    bucket = open_bucket(url)
    shard, *_ = shards_of_log(bucket, recording, settings)
    parts = build_parts(
        odometry=settings.odometry, supervised="recorded", selfsupervised=settings.selfsupervised
    )
    frames = islice(read_shard(bucket, recording, shard, settings).frames(), stop)
    deque(parts.selfsupervised(parts.odometry(frames)), maxlen=0)
    return peak_memory_bytes()


def _since(
    before: Mapping[str, float], watch: StageClock
) -> tuple[dict[str, float], Mapping[str, float]]:
    """Return milliseconds of each stage and step since the last frame, and the clock's reading."""
    now = {str(stage): seconds for stage, seconds in watch.seconds.items()}
    took = {name: MS_PER_S * (s - before.get(name, 0.0)) for name, s in now.items()}
    row = {name: took.pop(name) for name in _BEFORE_THE_STREAM}
    row[STREAM] = sum(took.values())
    rest = took.pop(STREAM)
    row |= {f"{STREAM}: {name}": ms for name, ms in took.items()}
    row[f"{STREAM}: rest"] = rest
    return row, now


def _times(rows: Sequence[Mapping[str, float]]) -> Iterator[StepTime]:
    """Summarise each part; a step that a frame did not run took no time in it."""
    for name in dict.fromkeys(name for row in rows for name in row):
        ms = np.array([row.get(name, 0.0) for row in rows])
        yield StepTime(
            part=name,
            median_ms=round(float(np.median(ms)), 3),
            p95_ms=round(float(np.percentile(ms, 95)), 3),
            mean_ms=round(float(ms.mean()), 3),
        )


def _idle_bytes() -> int:
    """Measure the memory of an idle Python process, bytes."""
    command = [sys.executable, "-c", _OWN_MEMORY]
    asked = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603 own
    return int(asked.stdout)
