"""Pipeline profile: time of `score` per stage, with lower bounds from the same run and frames."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from time import perf_counter
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from schemas.work import Recording, Shard
from workers.errors import LogUnusableError
from workers.ingest.read import read_shard
from workers.lab.evaluation.benchmarks.lower_bounds import (
    MS_PER_S,
    kiss_icp_ms,
    networks_ms,
    patchwork_ms,
    reading_ms,
)
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.mine import MiningReport, mine_records
from workers.parts.registry import build_parts
from workers.version import files_of, pipeline_version

WHOLE: Final = "score"
WARMING_FRAMES: Final = 5
"""Frames not counted at the start of each part: libraries load, loops compile, caches fill."""


_FLOORS: Final[Mapping[str, Callable[[Sequence[LidarFrame]], Iterator[float]]]] = {
    "kiss-icp alone": kiss_icp_ms,
    "patchwork++ alone": patchwork_ms,
    "networks alone": networks_ms,
}


class PartTime(BaseModel):
    """Time of one part per frame."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    part: str = Field(description="`score` is the whole path, `score: …` its stages.")
    frames: int = Field(ge=0, description="Frames that were timed.")
    median_ms: float = Field(description="Per frame; stages that run once per scene show 0.")
    p95_ms: float
    mean_ms: float = Field(description="Work done once per scene is spread over its frames.")
    share: float = Field(description="Mean over that of the whole path.")


def bench_pipeline(
    bucket: Bucket,
    recording: Recording,
    settings: MiningSettings,
    *,
    frames: int = 30,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[PartTime]:
    """Time the whole path of `score`, its stages, and its lower bounds, one after the other.

    The lower bounds are range read with CRC and decompression, KISS-ICP, Patchwork++ and the two
    networks, each alone, on the same frames and in the same process.

    Args:
        bucket: Bucket of the recording.
        recording: The log; its first frames are used.
        settings: Names of the parts, and ingest settings.
        frames: Number of timed frames, after a few warm-up frames.
        on_progress: Called with the number of passes done, and their total.

    Raises:
        LogUnusableError: If the log cannot be mined.
    """
    whole_log, *_ = shards_of_log(bucket, recording, settings)
    on_progress(0, 5)
    same_frames = _frames(bucket, recording, whole_log, settings, wanted=frames + WARMING_FRAMES)
    shard = _until(whole_log, same_frames[-1].stamp_ns, scene_s=settings.grid.scene_s)
    measured = _whole_path(bucket, recording, shard, settings)
    on_progress(1, 5)
    measured["decompression alone"] = list(
        islice(reading_ms(bucket, recording, shard), len(same_frames))
    )
    on_progress(2, 5)
    for done, (name, floor) in enumerate(_FLOORS.items(), start=3):
        measured[name] = list(floor(same_frames))
        on_progress(done, 5)
    whole_ms = float(np.mean(_counted(measured[WHOLE])))
    return [_row(name, _counted(times), whole_ms) for name, times in measured.items()]


def _until(shard: Shard, stamp_ns: int, *, scene_s: float) -> Shard:
    """Cut a shard after the scene that contains this instant, so that scenes are timed whole."""
    scene_ns = round(scene_s * NS_PER_S)
    end_ns = shard.start_ns + ((stamp_ns - shard.start_ns) // scene_ns + 1) * scene_ns
    if end_ns >= shard.end_ns:
        return shard
    return shard.model_copy(
        update={
            "end_ns": end_ns,
            "lookahead_end_ns": end_ns,
            "last_of_log": False,
            "chunks": tuple(ref for ref in shard.chunks if ref.start_ns < end_ns),
        }
    )


def _whole_path(
    bucket: Bucket, recording: Recording, shard: Shard, settings: MiningSettings
) -> dict[str, Sequence[float]]:
    """Mine a shard, and split the time between frames by stage."""
    parts = build_parts(
        odometry=settings.odometry,
        supervised=settings.supervised,
        selfsupervised=settings.selfsupervised,
        instances=settings.instances,
        files=files_of(settings),
    )
    account = MiningReport()
    instants: list[float] = []
    seconds: list[dict[str, float]] = []

    def look() -> None:
        instants.append(perf_counter())
        seconds.append({str(stage): s for stage, s in account.clock.seconds.items()})

    for _ in mine_records(
        bucket,
        recording,
        shard,
        settings=settings,
        parts=parts,
        pipeline_version=pipeline_version(settings, parts),
        report=account,
        check=look,
    ):
        pass
    look()
    split = {
        f"{WHOLE}: {stage}": (np.diff([s.get(stage, 0.0) for s in seconds]) * MS_PER_S).tolist()
        for stage in sorted(seconds[-1])
    }
    return {WHOLE: (np.diff(instants) * MS_PER_S).tolist(), **split}


def _frames(
    bucket: Bucket, recording: Recording, shard: Shard, settings: MiningSettings, *, wanted: int
) -> list[LidarFrame]:
    reader = read_shard(bucket, recording, shard, settings)
    frames = list(islice(reader.frames(), wanted))
    if not frames:
        raise LogUnusableError(f"cannot time {recording.log_id}: no frame of it can be read")
    return frames


def _counted(times: Sequence[float]) -> Sequence[float]:
    return times[WARMING_FRAMES:] or times


def _row(name: str, times: Sequence[float], whole_ms: float) -> PartTime:
    ms = np.array(times if len(times) else [0.0])
    return PartTime(
        part=name,
        frames=len(times),
        median_ms=round(float(np.median(ms)), 3),
        p95_ms=round(float(np.percentile(ms, 95)), 3),
        mean_ms=round(float(ms.mean()), 3),
        share=round(float(ms.mean()) / whole_ms, 4) if whole_ms > 0 else 0.0,
    )
