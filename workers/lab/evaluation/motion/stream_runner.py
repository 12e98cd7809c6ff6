"""Stream runner: runs the streams over a whole log and times them, with degraded input if asked."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import tee
from typing import cast

from schemas.arrays import Mask
from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import FrameLabels
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from schemas.work import Recording
from workers.ingest.read import read_shard
from workers.lab.evaluation.benchmarks.lower_bounds import MS_PER_S
from workers.lab.evaluation.motion.counts import StreamName
from workers.lab.evaluation.motion.disturbance import (
    Disturbance,
    NumberedFrame,
    with_yaw_noise,
    without_beams,
)
from workers.lab.evaluation.truth.truth import LogTruth
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.parts.protocols import Odometry, Stream
from workers.stage_timing import Stage, StageClock


@dataclass(frozen=True, slots=True, eq=False)
class StreamOutput:
    """Labels of the streams for one frame.

    Attributes:
        number: Number of the frame in the truth.
        whole: The frame with all its recorded points.
        posed: The frame given to the streams, with its pose.
        kept: (N,) recorded points given to them; None for all.
        labels: Labels of those points, by stream.
        stage_ms: Time of each stage for this frame, milliseconds.
    """

    number: int
    whole: LidarFrame
    posed: PosedFrame
    kept: Mask | None
    labels: Mapping[StreamName, FrameLabels]
    stage_ms: Mapping[str, float]


def run_streams(
    bucket: Bucket,
    recording: Recording,
    truth: LogTruth,
    *,
    odometry: Odometry,
    streams: Mapping[StreamName, Stream],
    settings: MiningSettings,
    disturbance: Disturbance,
) -> Iterator[StreamOutput]:
    """Run streams over a whole log, from its first frame on.

    Args:
        bucket: Bucket of the log.
        recording: The log.
        truth: Truth of the log; it names the lidar and numbers the frames.
        odometry: Odometry that poses the frames.
        streams: Streams by name; all get the same frames and poses.
        settings: Ingest settings.
        disturbance: Degradation of the log.

    Raises:
        LogUnusableError: If the log cannot be mined, or beams are to be removed and it has none.
        TruthUnusableError: If the truth does not know a frame.
    """
    number_of_stamp: dict[int, int] = {}
    settings = _read_for(streams, settings)
    for shard in shards_of_log(bucket, recording, settings, topic=truth.topic):
        clock = StageClock()
        read = clock.drawn("ingest", read_shard(bucket, recording, shard, settings).frames())
        numbered = (
            each
            for each in _numbered(read, truth, number_of_stamp)
            if each.number % disturbance.every == 0
        )
        given = tee(without_beams(numbered, disturbance.rows), 3)
        posed = clock.drawn("odometry", odometry(each.frame for each in given[0]))
        noisy = with_yaw_noise(posed, (each.number for each in given[1]), disturbance.yaw_noise_deg)
        pulled, *inputs = tee(noisy, 1 + len(streams))
        answers = [
            # streams are stages to the clock, with names of their own
            clock.drawn(cast(Stage, name), stream(each))
            for (name, stream), each in zip(streams.items(), inputs, strict=True)
        ]
        before: dict[str, float] = {}
        for each, frame, *labels in zip(given[2], pulled, *answers, strict=True):
            seconds = {str(stage): s for stage, s in clock.seconds.items()}
            took_ms = {k: MS_PER_S * (s - before.get(k, 0.0)) for k, s in seconds.items()}
            before = seconds
            if shard.start_ns <= each.whole.stamp_ns < shard.end_ns:
                by_stream = dict(zip(streams, labels, strict=True))
                yield StreamOutput(each.number, each.whole, frame, each.kept, by_stream, took_ms)


def _read_for(streams: Iterable[StreamName], settings: MiningSettings) -> MiningSettings:
    """Enable reading of recorded labels where one of the streams needs them."""
    candidates = [settings.model_copy(update={"supervised": name}) for name in streams]
    return next((each for each in candidates if each.takes_recorded), settings)


def _numbered(
    frames: Iterable[LidarFrame], truth: LogTruth, number_of_stamp: dict[int, int]
) -> Iterator[NumberedFrame]:
    """Number frames as the truth does; warm-up frames of a shard keep their numbers."""
    for frame in frames:
        number = number_of_stamp.get(frame.stamp_ns)
        if number is None:
            number = truth.number_of(frame, position=len(number_of_stamp))
            number_of_stamp[frame.stamp_ns] = number
        yield NumberedFrame(number, frame, frame)
