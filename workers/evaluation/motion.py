"""Judges motion labels against truth, on the very path that mining takes."""

from collections.abc import Callable, Iterator
from itertools import tee
from pathlib import Path

import numpy as np

from schemas.bucket import Bucket, open_bucket
from schemas.frame import LidarFrame
from schemas.labels import Agreement, FrameLabels
from schemas.recordings import group_recordings
from schemas.work import MiningSettings, Recording
from workers.contradiction.compare import compare
from workers.evaluation.counting import count_frame
from workers.evaluation.table import (
    LogCounts,
    LogEvaluation,
    StreamCounts,
    StreamName,
    evaluation_of,
    total_of,
)
from workers.evaluation.truth import LogTruth, TruthUnusableError
from workers.evaluation.whole_log import shards_of_log
from workers.ingest.read import read_shard
from workers.registry import Parts, Stream, build_parts


def evaluate_motion(
    bucket_url: str,
    truth: Path,
    *,
    frames: tuple[int, int | None] = (0, None),
    settings: MiningSettings,
    stream: str = "selfsupervised",
    both: bool = True,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[LogEvaluation]:
    """Judge a stream's motion labels on every log of a bucket that has truth.

    Each log is one shard, so that streams keep their state from its first frame on; odometry and
    streams are those of the settings, read and posed as a worker would.

    Args:
        bucket_url: URL or path of the bucket.
        truth: Folder of truth: that of `x/y.mcap` lies in `x/y`.
        frames: First frame that is judged and the first that is not any more (None: all the rest),
            counted in each log; earlier ones run through the streams unjudged.
        settings: Names of the parts and how logs are read.
        stream: Whose figures stand at the top of each row.
        both: Run the other stream too, for its table and for the share of contradicted points.
        on_progress: Told how many frames are done, and of about how many.

    Returns:
        One row for each log, and a last one, `all`, of the counts of all logs.

    Raises:
        TruthUnusableError: If no log has truth, or truth does not fit its log.
        LogUnusableError: If a log with truth cannot be mined.
    """
    if stream not in ("selfsupervised", "supervised"):
        raise LookupError(f"no stream {stream!r}; known: selfsupervised, supervised")
    chosen: StreamName = "supervised" if stream == "supervised" else "selfsupervised"
    bucket = open_bucket(bucket_url)
    known = [
        (recording, found)
        for recording in group_recordings(bucket.list())
        if (found := LogTruth.beside(recording, truth)) is not None
    ]
    if not known:
        raise TruthUnusableError(f"no log of {bucket.url} has truth in {truth}")
    parts = build_parts(
        odometry=settings.odometry,
        supervised=settings.supervised,
        selfsupervised=settings.selfsupervised,
    )
    streams = _streams(parts, chosen, both=both)
    judged = [_clipped(frames, len(found)) for _, found in known]
    total = sum(each.stop for each in judged if each)
    rows, counts, done = [], [], 0
    for (recording, found), numbers in zip(known, judged, strict=True):
        counted = LogCounts(streams={name: StreamCounts() for name in streams})
        run = _labelled(bucket, recording, found, parts, streams, settings) if numbers else ()
        for frame, labels, number in run:
            if number >= numbers.stop:
                break
            done += 1
            on_progress(done, total)
            if number in numbers:
                _count(counted, frame, labels, found, number)
        counts.append(counted)
        rows.append(evaluation_of(recording.log_id, counted, stream=chosen))
    return [*rows, evaluation_of("all", total_of(counts), stream=chosen)]


def _clipped(frames: tuple[int, int | None], length: int) -> range:
    first, last = frames
    return range(first, length if last is None else min(last, length))


def _streams(parts: Parts, chosen: StreamName, *, both: bool) -> dict[StreamName, Stream]:
    streams: dict[StreamName, Stream] = {
        "selfsupervised": parts.selfsupervised,
        "supervised": parts.supervised,
    }
    return streams if both else {chosen: streams[chosen]}


def _labelled(
    bucket: Bucket,
    recording: Recording,
    truth: LogTruth,
    parts: Parts,
    streams: dict[StreamName, Stream],
    settings: MiningSettings,
) -> Iterator[tuple[LidarFrame, dict[StreamName, FrameLabels], int]]:
    """Run the streams over a whole log; yield each frame, their labels and the frame's number."""
    position = 0
    for shard in shards_of_log(bucket, recording, settings, topic=truth.topic):
        reader = read_shard(bucket, recording, shard, settings)
        posed, *inputs = tee(parts.odometry(reader.frames()), 1 + len(streams))
        answers = [run(each) for run, each in zip(streams.values(), inputs, strict=True)]
        for each, *labels in zip(posed, *answers, strict=True):
            frame = each.frame
            if not shard.start_ns <= frame.stamp_ns < shard.end_ns:
                continue
            number = truth.number_of(frame, position=position)
            position += 1
            yield frame, dict(zip(streams, labels, strict=True)), number


def _count(
    counts: LogCounts,
    frame: LidarFrame,
    labels: dict[StreamName, FrameLabels],
    truth: LogTruth,
    number: int,
) -> None:
    true = truth.of(frame, number=number)
    if true is None:
        return
    counts.frames += 1
    for name, said in labels.items():
        counts.streams[name].add(count_frame(said.labels, true, frame.points_m))
    if len(labels) > 1:
        agreements = compare(labels["supervised"].labels, labels["selfsupervised"].labels)
        compared = agreements != Agreement.NOT_COMPARED
        counts.compared += int(compared.sum())
        differs = (agreements != Agreement.BOTH_STATIC) & (agreements != Agreement.BOTH_DYNAMIC)
        counts.contradicted += int(np.count_nonzero(compared & differs))
