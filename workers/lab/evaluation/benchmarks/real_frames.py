"""Frames of a real log, for comparison with simulated ones."""

from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from schemas.work import Recording
from workers.ingest.read import read_shard
from workers.lab.evaluation.benchmarks.bench_simulation import (
    FrameStatistics,
    SensorFrame,
    statistics_of,
)
from workers.lab.evaluation.truth.whole_log import shards_of_log

_FRAMES = 4
_STEP = 5


def real_statistics(
    bucket: Bucket, recording: Recording, settings: MiningSettings
) -> tuple[SensorFrame, FrameStatistics]:
    """Read every fifth frame from the start of a log.

    Returns:
        The first frame, and the statistics of all.

    Raises:
        CounterpointError: If the log cannot be read.
    """
    seen: list[SensorFrame] = []
    for shard in shards_of_log(bucket, recording, settings):
        for number, frame in enumerate(read_shard(bucket, recording, shard, settings).frames()):
            if number % _STEP == 0:
                kept = frame.valid_mask
                seen.append(
                    SensorFrame(frame.points_m[kept], frame.intensity[kept], frame.ring[kept])
                )
            if len(seen) == _FRAMES:
                break
        break
    return seen[0], statistics_of(recording.log_id.split("/")[-1], seen)
