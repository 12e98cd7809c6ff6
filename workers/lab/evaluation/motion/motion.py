"""Motion segmentation evaluation: labels against truth, on the same path that mining takes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, MotionLabels, Points
from schemas.mining import MiningSettings
from schemas.task import MOTION
from schemas.transport.bucket import open_bucket
from workers.contradiction.agreement import compare
from workers.lab.evaluation.motion.alternatives import OF_SETTINGS, build_streams, is_supervised
from workers.lab.evaluation.motion.counting import count_frame
from workers.lab.evaluation.motion.counts import LogCounts, StreamCounts, StreamName, total_of
from workers.lab.evaluation.motion.disturbance import Disturbance
from workers.lab.evaluation.motion.stream_runner import StreamOutput, run_streams
from workers.lab.evaluation.motion.table import LogEvaluation, evaluation_of
from workers.lab.evaluation.truth.truth import FrameTruth, LogTruth, logs_with_truth
from workers.parts.registry import build_odometry

UNDISTURBED = Disturbance()

_DIFFERING = [kind.code for kind in MOTION.kinds if not kind.of_witness]
"""Outcomes in which the two streams differ; where only the witness differs, they agree."""


@dataclass(frozen=True, slots=True, eq=False)
class EvaluatedFrame:
    """One evaluated frame: M points, those of the beams that were kept.

    Attributes:
        stream: Stream of the labels.
        log_id: Log of the frame.
        name: Its name in the truth, `x/y/NNNNNN`.
        points_m: (M, 3) sensor space.
        labels: (M,) labels of the stream.
        confirmed: (M,) points that it confirms; None where it does not report them.
        truth: (M,) true motion, in codes of the truth.
        kept: (N,) points of the recorded cloud that these are; None for all.
    """

    stream: StreamName
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
    stream: StreamName | Sequence[StreamName] = "selfsupervised",
    both: bool = True,
    disturbance: Disturbance = UNDISTURBED,
    on_frame: Callable[[EvaluatedFrame], None] = lambda judged: None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[LogEvaluation]:
    """Evaluate a stream's motion labels on every log of a bucket that has truth.

    Each log is one shard, so that streams keep their state from its first frame on. Odometry and
    streams are those of the settings, on frames read and posed as in a worker.

    Args:
        bucket_url: URL or path of the bucket.
        truth: Folder of truth: that of `x/y.mcap` is in `x/y`.
        frames: First evaluated frame and the end, exclusive (None: the rest), counted in each log;
            earlier frames run through the streams and are not counted.
        settings: Names of the parts, and ingest settings.
        stream: Stream of the figures at the top of each row: `selfsupervised` or `supervised` as
            the settings name them, or a part by name. Several run together on the same frames and
            poses.
        both: With one of the first two, run the other too, for its table and for the share of
            contradicted points.
        disturbance: Degradation applied to the logs before all stages.
        on_frame: Called with each evaluated frame, once for each stream at the top.
        on_progress: Called with the number of frames done, and about how many there are.

    Returns:
        One row for each log and stream, and last ones, `all`, over all logs.

    Raises:
        TruthUnusableError: If no log has truth, or truth does not fit its log.
        LogUnusableError: If a log with truth cannot be mined.
        UnknownPartError: If a stream does not exist.
    """
    chosen = (stream,) if isinstance(stream, str) else tuple(dict.fromkeys(stream))
    alone = chosen[0] if len(chosen) == 1 else ""
    others = tuple(name for name in OF_SETTINGS if both and alone in OF_SETTINGS and name != alone)
    streams = build_streams((*chosen, *others), settings)
    bucket = open_bucket(bucket_url)
    known = logs_with_truth(bucket, truth)
    odometry = build_odometry(settings.odometry)
    judged = [_clipped(frames, len(found)) for _, found in known]
    total = sum(each.stop for each in judged if each)
    rows, counts, done = [], [], 0
    for (recording, found), numbers in zip(known, judged, strict=True):
        counted = LogCounts(streams={name: StreamCounts() for name in streams})
        run = run_streams(
            bucket,
            recording,
            found,
            odometry=odometry,
            streams=streams,
            settings=settings,
            disturbance=disturbance,
        )
        for output in run if numbers else ():
            if output.number >= numbers.stop:
                break
            done += disturbance.every
            on_progress(done, total)
            true = found.of(output.whole, number=output.number)
            if output.number in numbers and true is not None:
                true = true if output.kept is None else true.of_points(output.kept)
                _count(counted, output, true, recording.log_id)
                for each in chosen:
                    on_frame(_judged(output, each, true, recording.log_id, found))
        counts.append(counted)
        rows.extend(_rows(recording.log_id, counted, chosen, others))
    return [*rows, *_rows("all", total_of(counts), chosen, others)]


def _rows(
    log: str, counts: LogCounts, chosen: Sequence[StreamName], others: Sequence[StreamName]
) -> list[LogEvaluation]:
    return [evaluation_of(log, counts, stream=name, others=others) for name in chosen]


def _clipped(frames: tuple[int, int | None], length: int) -> range:
    first, last = frames
    return range(first, length if last is None else min(last, length))


def _judged(
    output: StreamOutput, stream: StreamName, true: FrameTruth, log_id: str, truth: LogTruth
) -> EvaluatedFrame:
    predicted = output.labels[stream]
    return EvaluatedFrame(
        stream=stream,
        log_id=log_id,
        name=truth.name_of(output.number),
        points_m=output.posed.frame.points_m,
        labels=predicted.labels,
        confirmed=predicted.confirmed,
        truth=true.motion,
        kept=output.kept,
    )


def _count(counts: LogCounts, output: StreamOutput, true: FrameTruth, log_id: str) -> None:
    counts.frames += 1
    for stage, took_ms in output.stage_ms.items():
        counts.stage_ms.setdefault(stage, []).append(took_ms)
    for name, predicted in output.labels.items():
        counts.streams[name].add(
            count_frame(
                predicted,
                true,
                output.posed.frame.points_m,
                log_id=log_id,
                odom_from_sensor=output.posed.odom_from_sensor,
            )
        )
    supervised = [name for name in output.labels if is_supervised(name)]
    others = [name for name in output.labels if not is_supervised(name)]
    for semantic, predictive in product(supervised, others):
        agreements = compare(output.labels[semantic].labels, output.labels[predictive].labels)
        differs = np.isin(agreements, _DIFFERING)
        compared = np.count_nonzero(agreements != MOTION.not_compared)
        counts.compared[semantic, predictive] += int(compared)
        counts.contradicted[semantic, predictive] += int(np.count_nonzero(differs))
