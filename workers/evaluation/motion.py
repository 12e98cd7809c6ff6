"""Judges motion labels against truth, on the very path that mining takes."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, MotionLabels, Points
from schemas.bucket import open_bucket
from schemas.labels import Agreement, FrameLabels
from schemas.recordings import group_recordings
from schemas.work import MiningSettings
from workers.contradiction.compare import compare
from workers.evaluation.counting import count_frame
from workers.evaluation.counts import LogCounts, StreamCounts, StreamName, total_of
from workers.evaluation.disturbance import Disturbance
from workers.evaluation.judged import Answered, answers_of
from workers.evaluation.table import LogEvaluation, evaluation_of
from workers.evaluation.truth import FrameTruth, LogTruth, TruthUnusableError
from workers.registry import build_parts

UNDISTURBED = Disturbance()


@dataclass(frozen=True, slots=True, eq=False)
class JudgedFrame:
    """One frame that was judged: M points, those of the beams that were kept.

    Attributes:
        log_id: Whose it is.
        name: As its truth is named, `x/y/NNNNNN`.
        points_m: (M, 3) sensor space.
        labels: (M,) of the judged stream.
        confirmed: (M,) which of them it confirms; None where it does not tell.
        truth: (M,) true motion, in codes of the truth.
        kept: (N,) which points of the recorded cloud they are; None for all.
    """

    log_id: str
    name: str
    points_m: Points
    labels: MotionLabels
    confirmed: Mask | None
    truth: NDArray[np.uint8]
    kept: Mask | None


def evaluate_motion(
    bucket_url: str,
    truth: Path,
    *,
    frames: tuple[int, int | None] = (0, None),
    settings: MiningSettings,
    stream: str = "selfsupervised",
    both: bool = True,
    disturbance: Disturbance = UNDISTURBED,
    on_frame: Callable[[JudgedFrame], None] = lambda judged: None,
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
        disturbance: What the logs are made worse by before anything sees them.
        on_frame: Told of each judged frame what the stream at the top said about it.
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
        model=settings.model,
    )
    streams: tuple[StreamName, ...] = ("selfsupervised", "supervised") if both else (chosen,)
    judged = [_clipped(frames, len(found)) for _, found in known]
    total = sum(each.stop for each in judged if each)
    rows, counts, done = [], [], 0
    for (recording, found), numbers in zip(known, judged, strict=True):
        counted = LogCounts(streams={name: StreamCounts() for name in streams})
        run = answers_of(
            bucket,
            recording,
            found,
            parts=parts,
            streams=streams,
            settings=settings,
            disturbance=disturbance,
        )
        for answered in run if numbers else ():
            if answered.number >= numbers.stop:
                break
            done += disturbance.every
            on_progress(done, total)
            true = found.of(answered.whole, number=answered.number)
            if answered.number in numbers and true is not None:
                true = true if answered.kept is None else true.of_points(answered.kept)
                _count(counted, answered, true, recording.log_id)
                said, name = answered.labels[chosen], found.name_of(answered.number)
                on_frame(_judged(answered, said, true, recording.log_id, name))
        counts.append(counted)
        rows.append(evaluation_of(recording.log_id, counted, stream=chosen))
    return [*rows, evaluation_of("all", total_of(counts), stream=chosen)]


def _clipped(frames: tuple[int, int | None], length: int) -> range:
    first, last = frames
    return range(first, length if last is None else min(last, length))


def _judged(
    answered: Answered, said: FrameLabels, true: FrameTruth, log_id: str, name: str
) -> JudgedFrame:
    return JudgedFrame(
        log_id=log_id,
        name=name,
        points_m=answered.posed.frame.points_m,
        labels=said.labels,
        confirmed=said.confirmed,
        truth=true.motion,
        kept=answered.kept,
    )


def _count(counts: LogCounts, answered: Answered, true: FrameTruth, log_id: str) -> None:
    counts.frames += 1
    for stage, took_ms in answered.stage_ms.items():
        counts.stage_ms.setdefault(stage, []).append(took_ms)
    counts.stage_ms.setdefault("total", []).append(sum(answered.stage_ms.values()))
    for name, said in answered.labels.items():
        counts.streams[name].add(
            count_frame(
                said,
                true,
                answered.posed.frame.points_m,
                log_id=log_id,
                odom_from_sensor=answered.posed.odom_from_sensor,
            )
        )
    if len(answered.labels) > 1:
        agreements = compare(
            answered.labels["supervised"].labels, answered.labels["selfsupervised"].labels
        )
        compared = agreements != Agreement.NOT_COMPARED
        counts.compared += int(compared.sum())
        differs = (agreements != Agreement.BOTH_STATIC) & (agreements != Agreement.BOTH_DYNAMIC)
        counts.contradicted += int(np.count_nonzero(compared & differs))
