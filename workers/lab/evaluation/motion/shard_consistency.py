"""Shard consistency: labels of separately mined shards against labels of the whole log."""

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import NS_PER_S
from schemas.errors import PermanentError
from schemas.frame import LidarFrame
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket, open_bucket
from schemas.transport.recordings import group_recordings
from schemas.work import Recording, Shard
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.parts.protocols import Odometry, Stream
from workers.parts.registry import build_odometry, build_selfsupervised

FROM_S: Final = (0, 1, 2, 5, 10)
"""Edges of the time bins, seconds after the window begins: a short warm-up shows in the first."""

Labels = dict[int, NDArray[np.uint8]]


class NoShardsError(PermanentError):
    """No log of a bucket is long enough for more than one shard."""


class ShardsEvaluation(BaseModel):
    """Agreement of the labels of shards with those of the whole log."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    log: str = Field(description="Log id, or `all`.")
    shards: int = Field(description="Number of shards of the log.")
    points: int = Field(description="Points in their windows.")
    equal_share: float = Field(description="Of those, with the same label as in the whole log.")
    equal_by_second: dict[str, float] = Field(
        description="The same for windows with a warm-up, from this many seconds on."
    )


class _LabelAgreement:
    """Points in windows, and those among them with the same label."""

    def __init__(self) -> None:
        self.shards = self.points = self.equal = 0
        self.by_second = np.zeros((len(FROM_S), 2), np.int64)

    def add(self, other: "_LabelAgreement") -> None:
        """Add the counts of another log."""
        self.shards, self.points = self.shards + other.shards, self.points + other.points
        self.equal += other.equal
        self.by_second += other.by_second

    def compare(self, shard: Shard, whole: Labels, part: Labels) -> None:
        """Count the frames of one window."""
        self.shards += 1
        for stamp_ns, labels in part.items():
            equal = int((labels == whole[stamp_ns]).sum())
            self.points, self.equal = self.points + len(labels), self.equal + equal
            if not shard.warmup_start_ns < shard.start_ns:
                continue
            since_s = (stamp_ns - shard.start_ns) / NS_PER_S
            at = int(np.searchsorted(FROM_S, since_s, side="right")) - 1
            self.by_second[at] += len(labels), equal

    def row(self, log: str) -> ShardsEvaluation:
        """Build the row of a log."""
        return ShardsEvaluation(
            log=log,
            shards=self.shards,
            points=self.points,
            equal_share=round(self.equal / max(self.points, 1), 6),
            equal_by_second={
                str(begin): round(int(equal) / int(points), 6)
                for begin, (points, equal) in zip(FROM_S, self.by_second, strict=True)
                if points
            },
        )


def evaluate_shards(
    bucket_url: str,
    *,
    settings: MiningSettings,
    on_progress: Callable[[int], None] = lambda done: None,
) -> list[ShardsEvaluation]:
    """Label every log whole and in shards, of its first lidar, and compare per point.

    Args:
        bucket_url: URL or path of the bucket.
        settings: Odometry, self-supervised stream, and the grid of the shards.
        on_progress: Called with the number of frames done.

    Returns:
        One row for each log of more than one shard, and a last one, `all`.

    Raises:
        NoShardsError: If no log has more than one.
        UnknownPartError: If a part does not exist.
    """
    bucket, rows, total, done = (
        open_bucket(bucket_url),
        list[ShardsEvaluation](),
        _LabelAgreement(),
        0,
    )
    odometry = build_odometry(settings.odometry)
    stream = build_selfsupervised(settings.selfsupervised)

    def labels(recording: Recording, shard: Shard) -> Labels:
        nonlocal done
        collected = Labels()
        for stamp_ns, of_frame in _labelled(bucket, recording, shard, settings, odometry, stream):
            done += 1
            on_progress(done)
            if shard.start_ns <= stamp_ns < shard.end_ns:
                collected[stamp_ns] = of_frame
        return collected

    for recording in group_recordings(bucket.list()):
        plan = plan_recording(bucket, recording, settings)
        shards = [shard for shard in plan.shards if shard.lidar.topic == plan.lidar_topics[0]]
        if len(shards) < 2:
            continue
        whole = Labels()
        for shard in shards_of_log(bucket, recording, settings):
            whole |= labels(recording, shard)
        counted = _LabelAgreement()
        for shard in shards:
            counted.compare(shard, whole, labels(recording, shard))
        rows.append(counted.row(recording.log_id))
        total.add(counted)
    if not rows:
        raise NoShardsError(
            f"no log of {bucket.url} is longer than a shard of {settings.grid.shard_s:g} s: "
            "cut them into shorter ones, such as --shard-seconds 2"
        )
    return [*rows, total.row("all")]


def _labelled(
    bucket: Bucket,
    recording: Recording,
    shard: Shard,
    settings: MiningSettings,
    odometry: Odometry,
    stream: Stream,
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yield the time of each frame of a shard, warm-up included, and the labels of its points."""
    stamps: list[int] = []

    def read() -> Iterator[LidarFrame]:
        for frame in read_shard(bucket, recording, shard, settings).frames():
            stamps.append(frame.stamp_ns)
            yield frame

    for number, labels in enumerate(stream(odometry(read()))):
        yield stamps[number], labels.labels
