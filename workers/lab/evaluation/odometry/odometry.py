"""Odometry metrics: relative pose errors per frame, and over segments as KITTI measures them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial.transform import Rotation

from schemas.frame import LidarFrame
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from workers.lab.evaluation.figures import Interval, pooled
from workers.lab.evaluation.odometry.sources import (
    CONSTANT_VELOCITY,
    FLOORS,
    build,
    odometries_in,
)
from workers.lab.evaluation.posed_frames import posed_frames
from workers.lab.evaluation.truth.trajectory import LogTrajectory, trajectory_of
from workers.lab.evaluation.truth.truth import TruthUnusableError, logs_with_truth

SEGMENTS_M: Final = tuple(range(100, 900, 100))
"""Lengths of segments, metres (KITTI odometry benchmark)."""

SEGMENT_STEP: Final = 10
"""Frames from the beginning of one segment to the next, as in KITTI's development kit."""

POSES_OF: Final = {True: "truth", False: "ICP, not truth"}
"""Name of the poses that an odometry is compared with, by whether they are truth."""


class OdometryEvaluation(BaseModel):
    """Relative pose errors of one odometry on one log, or on all."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    log: str = Field(description="Log id, or `all`.")
    odometry: str = Field(description="Name of the odometry.")
    compared_with: str = Field(description="Source of the poses that it is compared with.")
    frames: int = Field(description="Pairs of consecutive frames compared.")
    path_m: float = Field(description="Length of the path by those poses, metres.")
    translation_m: float | None = Field(description="Mean error of a frame's motion, metres.")
    rotation_deg: float | None = Field(description="Mean error of a frame's rotation, degrees.")
    translation_m_per_100_m: float | None = Field(
        description="Mean over segments of 100 to 800 m; null where the path is shorter."
    )
    rotation_deg_per_100_m: float | None = Field(description="The same of the rotation, degrees.")
    end_error_m_per_100_m: float | None = Field(
        description="Error from the first to the last frame; null for a path below 1 m."
    )
    interval: Interval | None = Field(
        description="Bootstrap of `translation_m` over logs, 95 %; null with fewer than three."
    )


@dataclass(slots=True)
class _Errors:
    """Errors of one log: of frames, of segments, and from end to end."""

    compared_with: str
    path_m: float = 0.0
    frame_m: list[float] = field(default_factory=list)
    frame_deg: list[float] = field(default_factory=list)
    segment_m: list[float] = field(default_factory=list)
    segment_deg: list[float] = field(default_factory=list)
    end_m: float | None = None


def evaluate_odometry(
    bucket_url: str,
    truth: Path,
    *,
    frames: range,
    settings: MiningSettings,
    odometries: Sequence[str] = (),
    on_progress: Callable[[int], None] = lambda done: None,
) -> tuple[list[OdometryEvaluation], list[str]]:
    """Evaluate odometries on every log of a bucket whose truth has poses.

    A pose of ours belongs to the middle of a sweep whose points have times, and is compared with
    the true pose at that time.

    Args:
        bucket_url: URL or path of the bucket.
        truth: Folder of truth: that of `x/y.mcap` is in `x/y`.
        frames: Frames to evaluate, counted in each log; earlier ones warm up.
        settings: Names of the parts, and ingest settings.
        odometries: Names in addition to that of the settings and the floors; empty: those whose
            weights there are.
        on_progress: Called with the number of frames done, of all odometries together.

    Returns:
        Rows of each log and of all logs, the odometry of the settings first; and the logs without
        poses. The last rows are over the logs with true poses, where there are any.

    Raises:
        TruthUnusableError: If no log has poses.
        UnknownPartError: If an odometry does not exist.
    """
    named = odometries or odometries_in(settings.weights)
    names = list(dict.fromkeys([settings.odometry, *named, *FLOORS]))
    built = {name: build(name, settings) for name in names if name != CONSTANT_VELOCITY}
    bucket = open_bucket(bucket_url)
    per_log: dict[str, dict[str, _Errors]] = {}
    without, done = [], 0
    for recording, found in logs_with_truth(bucket, truth, needs_labels=False):
        known = trajectory_of(recording, truth)
        if known is None:
            without.append(recording.log_id)
            continue
        errors: dict[str, _Errors] = {}
        for name, odometry in built.items():
            estimated: list[NDArray[np.float64]] = []
            times_ns: list[int] = []
            for _, posed in posed_frames(
                bucket, recording, found, odometry=odometry, settings=settings, frames=frames
            ):
                estimated.append(posed.odom_from_sensor)
                times_ns.append(time_of(posed.frame))
                done += 1
                on_progress(done)
            true, estimates = _aligned(known, times_ns, estimated)
            errors[name] = errors_of(true, estimates, known.is_truth)
            if CONSTANT_VELOCITY not in errors:
                errors[CONSTANT_VELOCITY] = errors_of(true, None, known.is_truth)
        per_log[recording.log_id] = errors
    if not per_log:
        raise TruthUnusableError(
            f"no log of {bucket.url} has poses in {truth}: poses.npz or poses_icp.npz; "
            "deploy/TRUTH.md defines the format"
        )
    rows = [_row(log, name, [errors[name]]) for log, errors in per_log.items() for name in names]
    true_logs = [e for e in per_log.values() if e[names[0]].compared_with == POSES_OF[True]]
    judged = true_logs or list(per_log.values())
    rows += [_row("all", name, [each[name] for each in judged]) for name in names]
    return rows, without


def time_of(frame: LidarFrame) -> int:
    """Return the time of a frame's pose: the middle of its points' times, else its stamp."""
    if not frame.has_point_time or not frame.valid_mask.any():
        return frame.stamp_ns
    offset_ns = frame.offset_ns[frame.valid_mask]
    return frame.stamp_ns + (int(offset_ns.min()) + int(offset_ns.max())) // 2


def _aligned(
    known: LogTrajectory, times_ns: Sequence[int], estimated: Sequence[NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return true and estimated poses at the times that truth covers."""
    times = np.asarray(times_ns, np.int64)
    covered = (times >= known.times_ns[0]) & (times <= known.times_ns[-1])
    poses = np.asarray(estimated, np.float64).reshape(-1, 4, 4)
    return known.interpolated().at(times[covered]), poses[covered]


def errors_of(
    true: NDArray[np.float64], estimated: NDArray[np.float64] | None, is_truth: bool
) -> _Errors:
    """Compare poses, (F, 4, 4) each; None evaluates the constant velocity of truth."""
    errors = _Errors(POSES_OF[is_truth])
    if len(true) < 2:
        return errors
    true_steps = np.linalg.inv(true[:-1]) @ true[1:]
    lengths = np.linalg.norm(true_steps[:, :3, 3], axis=1)
    errors.path_m = float(lengths.sum())
    if estimated is None:
        pairs = zip(true_steps[1:], true_steps[:-1], strict=True)
    else:
        pairs = zip(true_steps, np.linalg.inv(estimated[:-1]) @ estimated[1:], strict=True)
    for expected, found in pairs:
        off = np.linalg.inv(expected) @ found
        errors.frame_m.append(float(np.linalg.norm(off[:3, 3])))
        errors.frame_deg.append(_angle_deg(off))
    if estimated is None:
        return errors
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    for first, last, length in _segments(along):
        off = _relative_error(true, estimated, first, last)
        errors.segment_m.append(100 * float(np.linalg.norm(off[:3, 3])) / length)
        errors.segment_deg.append(100 * _angle_deg(off) / length)
    if errors.path_m >= 1.0:
        off = _relative_error(true, estimated, 0, len(true) - 1)
        errors.end_m = 100 * float(np.linalg.norm(off[:3, 3])) / errors.path_m
    return errors


def _segments(along_m: NDArray[np.float64]) -> Iterator[tuple[int, int, float]]:
    for first in range(0, len(along_m), SEGMENT_STEP):
        for length in SEGMENTS_M:
            last = int(np.searchsorted(along_m, along_m[first] + length))
            if last < len(along_m):
                yield first, last, float(length)


def _relative_error(
    true: NDArray[np.float64], estimated: NDArray[np.float64], first: int, last: int
) -> NDArray[np.float64]:
    expected = np.linalg.inv(true[first]) @ true[last]
    found = np.linalg.inv(estimated[first]) @ estimated[last]
    off: NDArray[np.float64] = np.linalg.inv(expected) @ found
    return off


def _angle_deg(pose: NDArray[np.float64]) -> float:
    return float(np.degrees(np.linalg.norm(Rotation.from_matrix(pose[:3, :3]).as_rotvec())))


def _row(log: str, name: str, errors: Sequence[_Errors]) -> OdometryEvaluation:
    def mean(of: Callable[[_Errors], Sequence[float]]) -> float | None:
        return pooled([sum(of(each)) for each in errors], [len(of(each)) for each in errors])

    ends = [each.end_m for each in errors if each.end_m is not None]
    return OdometryEvaluation(
        log=log,
        odometry=name,
        compared_with=" and ".join(sorted({each.compared_with for each in errors})),
        frames=sum(len(each.frame_m) for each in errors),
        path_m=round(sum(each.path_m for each in errors), 2),
        translation_m=mean(lambda each: each.frame_m),
        rotation_deg=mean(lambda each: each.frame_deg),
        translation_m_per_100_m=mean(lambda each: each.segment_m),
        rotation_deg_per_100_m=mean(lambda each: each.segment_deg),
        end_error_m_per_100_m=pooled(sum(ends), len(ends)),
        interval=Interval.over_logs(
            [sum(each.frame_m) for each in errors], [len(each.frame_m) for each in errors]
        ),
    )
