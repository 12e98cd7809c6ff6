"""Semantic segmentation metrics: intersection over union of the supervised stream per class."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from workers.errors import UnknownPartError
from workers.lab.evaluation.motion.alternatives import build_streams
from workers.lab.evaluation.motion.disturbance import Disturbance
from workers.lab.evaluation.motion.stream_runner import run_streams
from workers.lab.evaluation.semantics.confusion import class_iou, joint_iou
from workers.lab.evaluation.truth.class_table import COARSE, MOVABLE, coarse_of_names
from workers.lab.evaluation.truth.truth import LogTruth, TruthUnusableError
from workers.parts.registry import build_odometry


class SemanticsEvaluation(BaseModel):
    """Segmentation metrics of a stream on one log, or on all."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    log: str = Field(description="Log id, or `all`.")
    frames: int = Field(description="Number of evaluated frames.")
    points: int = Field(description="Points whose true class is known.")
    miou: float | None = Field(description="Mean over the classes that truth has.")
    iou: dict[str, float] = Field(description="Of each coarse class that truth has.")
    movable_iou: float | None = Field(description="All movable classes, merged into one.")
    unanswered_share: float | None = Field(description="Of those points, without a class.")


def evaluate_semantics(
    bucket_url: str,
    truth: Path,
    *,
    frames: range | None = None,
    settings: MiningSettings,
    stream: str = "supervised",
    on_progress: Callable[[int], None] = lambda done: None,
) -> list[SemanticsEvaluation]:
    """Evaluate a stream's classes on every log of a bucket whose truth has classes.

    Classes are compared in the coarse ones of `class_table`; a point without a predicted class is a
    miss of its true class. Every log runs from its first frame on.

    Args:
        bucket_url: URL or path of the bucket.
        truth: Folder of truth: that of `x/y.mcap` is in `x/y`.
        frames: Frames to evaluate, counted in each log; None for all.
        settings: Names of the parts, and ingest settings.
        stream: `supervised`, as the settings name it, or a part by name.
        on_progress: Called with the number of frames done.

    Returns:
        One row for each log, and a last one, `all`, over the points of all logs.

    Raises:
        TruthUnusableError: If no log has truth with classes.
        UnknownPartError: If the stream does not exist or has no classes.
    """
    judged = build_streams([stream], settings)
    bucket, odometry = open_bucket(bucket_url), build_odometry(settings.odometry)
    rows, total, done, all_frames = [], _empty(), 0, 0
    for recording in group_recordings(bucket.list()):
        found = LogTruth.beside(recording, truth)
        if found is None:
            continue
        confusion, counted = _empty(), 0
        for output in run_streams(
            bucket,
            recording,
            found,
            odometry=odometry,
            streams=judged,
            settings=settings,
            disturbance=Disturbance(),
        ):
            if frames is not None and output.number >= frames.stop:
                break
            done += 1
            on_progress(done)
            if frames is not None and output.number not in frames:
                continue
            predicted = output.labels[stream].class_id
            if predicted is None:
                raise UnknownPartError(f"the stream {stream!r} has no classes to evaluate")
            true = found.classes_of(output.whole, number=output.number)
            if true is None:
                continue
            known = true > 0
            names = judged[stream].class_names  # a recorded model has its own per log
            of_class = np.concatenate([coarse_of_names(names), np.zeros(1, np.uint8)])  # -1: none
            np.add.at(confusion, (true[known], of_class[predicted[known]]), 1)
            counted += 1
        if counted:
            rows.append(_row(recording.log_id, confusion, counted))
            total, all_frames = total + confusion, all_frames + counted
    if not rows:
        raise TruthUnusableError(
            f"no log of {bucket.url} has semantic truth in {truth}: arrays semantic19, or "
            "semantic and a classes.json; deploy/TRUTH.md defines the format"
        )
    return [*rows, _row("all", total, all_frames)]


def _empty() -> NDArray[np.int64]:
    return np.zeros((len(COARSE), len(COARSE)), dtype=np.int64)


def _row(log: str, confusion: NDArray[np.int64], frames: int) -> SemanticsEvaluation:
    """Build the row of a confusion matrix: its rows are truth, its columns predictions."""
    iou = class_iou(confusion, COARSE)
    points = int(confusion.sum())
    return SemanticsEvaluation(
        log=log,
        frames=frames,
        points=points,
        miou=round(sum(iou.values()) / len(iou), 4) if iou else None,
        iou=iou,
        movable_iou=joint_iou(confusion, np.isin(COARSE, MOVABLE)),
        unanswered_share=round(float(confusion[:, 0].sum() / points), 4) if points else None,
    )
