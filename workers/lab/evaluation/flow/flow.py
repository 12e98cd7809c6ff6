"""Scene flow metrics: end-point error and accuracy of flows, over static and dynamic points."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import NS_PER_S, Mask
from schemas.frame import OdometryState, PosedFrame
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from workers.lab.evaluation.figures import Interval, pooled
from workers.lab.evaluation.flow.sources import FLOORS, build_flow, flows_in
from workers.lab.evaluation.flow.true_flow import true_flow
from workers.lab.evaluation.posed_frames import posed_frames
from workers.lab.evaluation.truth.trajectory import trajectory_of
from workers.lab.evaluation.truth.truth import (
    TRUTH_DYNAMIC,
    TRUTH_STATIC,
    LogTruth,
    TruthUnusableError,
    logs_with_truth,
)
from workers.lidar.preprocessing import MAX_RANGE_M, PreprocessedFrame, Preprocessor
from workers.paper.scene_flow import SceneFlowSource
from workers.parts.registry import build_odometry
from workers.points.se3 import inverse, transform

STRICT: Final = (0.05, 0.05)
RELAXED: Final = (0.1, 0.1)
"""Errors up to which a flow is right: metres, or a share of the true flow (FlowNet3D, 2019)."""

LONGEST_STEP_S: Final = 0.5
"""Longest time to the next frame, seconds."""

KINDS: Final = ("all", "static", "dynamic")


class FlowEvaluation(BaseModel):
    """Errors of one flow on one log, or on all; points off the ground within 80 m."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    log: str = Field(description="Log id, or `all`.")
    flow: str = Field(description="Name of the flow.")
    frames: int = Field(description="Frames with true flow and a next frame.")
    points: dict[str, int] = Field(description="Points by kind: all, static, dynamic.")
    epe_m: dict[str, float | None] = Field(description="Mean end-point error by kind, metres.")
    strict: dict[str, float | None] = Field(description="Share within 5 cm or 5 % by kind.")
    relaxed: dict[str, float | None] = Field(description="Share within 10 cm or 10 % by kind.")
    intervals: dict[str, Interval | None] = Field(
        description="Bootstrap of `epe_m` over logs, 95 %; null with fewer than three logs."
    )


@dataclass(slots=True)
class _Counts:
    """Sums of one frame or more, by kind: points, errors, right ones."""

    frames: int = 0
    sums: NDArray[np.float64] = field(default_factory=lambda: np.zeros((len(KINDS), 4)))

    def add(self, error_m: NDArray[np.float64], true_m: NDArray[np.float64], kind: Mask) -> None:
        """Add points; `kind` is true for dynamic ones."""
        size = np.maximum(np.linalg.norm(true_m, axis=1), 1e-9)
        right = [
            (error_m < metres) | (error_m / size < share) for metres, share in (STRICT, RELAXED)
        ]
        chosen = (np.ones_like(kind), ~kind, kind)
        for row, mask in enumerate(chosen):
            counted = [each[mask].sum() for each in right]
            self.sums[row] += (np.count_nonzero(mask), error_m[mask].sum(), *counted)
        self.frames += 1


def evaluate_flow(
    bucket_url: str,
    truth: Path,
    *,
    frames: range,
    settings: MiningSettings,
    flows: Sequence[str] = (),
    on_progress: Callable[[int], None] = lambda done: None,
) -> tuple[list[FlowEvaluation], list[str]]:
    """Evaluate scene flows on every log of a bucket whose truth has flow.

    Flows get what the two-stage stream gives them: voxels of points off the ground within 80 m,
    and the ego-motion of the odometry. A point has the flow of its voxel.

    Args:
        bucket_url: URL or path of the bucket.
        truth: Folder of truth: that of `x/y.mcap` is in `x/y`.
        frames: Frames to evaluate, counted in each log.
        settings: Names of the parts, and ingest settings.
        flows: Names of flows in addition to the floors; empty: those whose weights there are.
        on_progress: Called with the number of frames done.

    Returns:
        Rows of each log and of all logs, the floors first; and the logs without true flow.

    Raises:
        TruthUnusableError: If no log has true flow.
        UnknownPartError: If a flow does not exist.
    """
    named = flows or flows_in(settings.weights)
    sources = {
        name: build_flow(name, settings.weights) for name in dict.fromkeys([*FLOORS, *named])
    }
    bucket, odometry = open_bucket(bucket_url), build_odometry(settings.odometry)
    per_log: dict[str, dict[str, _Counts]] = {}
    without, done = [], 0
    for recording, found in logs_with_truth(bucket, truth):
        poses = trajectory_of(recording, truth)
        trajectory = poses.interpolated() if poses is not None and poses.is_truth else None
        counts = {name: _Counts() for name in sources}
        prepare = Preprocessor()
        before: _Prepared | None = None
        for number, posed in posed_frames(
            bucket, recording, found, odometry=odometry, settings=settings, frames=frames
        ):
            prepared = prepare(posed.frame, posed.odom_from_sensor, None)
            now = None if prepared is None else _Prepared(number, posed, prepared)
            if before is not None and now is not None and now.follows(before):
                true_m = true_flow(
                    before.posed.frame, posed.frame, found, trajectory, number=before.number
                )
                if true_m is not None:
                    _count(counts, sources, before, now, true_m, found)
            before = now
            done += 1
            on_progress(done)
        if any(each.frames for each in counts.values()):
            per_log[recording.log_id] = counts
        else:
            without.append(recording.log_id)
    if not per_log:
        raise TruthUnusableError(
            f"no log of {bucket.url} has true flow in {truth}: arrays `flow`, or motion, track, "
            "tracks.csv with boxes and poses.npz; deploy/TRUTH.md defines the format"
        )
    rows = [_row(log, name, [counts[name]]) for log, counts in per_log.items() for name in sources]
    rows += [_row("all", name, [each[name] for each in per_log.values()]) for name in sources]
    return rows, without


@dataclass(frozen=True, slots=True, eq=False)
class _Prepared:
    number: int
    posed: PosedFrame
    prepared: PreprocessedFrame

    def follows(self, before: "_Prepared") -> bool:
        """Return True if this is the next frame, and both poses can be trusted."""
        apart_ns = self.posed.frame.stamp_ns - before.posed.frame.stamp_ns
        lost = OdometryState.LOST in (self.posed.odometry, before.posed.odometry)
        return (
            self.number == before.number + 1
            and 0 < apart_ns <= LONGEST_STEP_S * NS_PER_S
            and not lost
        )

    @property
    def voxels_m(self) -> NDArray[np.float32]:
        """Return the voxels about the origin of the beams."""
        return transform(self.prepared.beams_from_odom, self.prepared.voxels.centroids_m)


def _count(
    counts: dict[str, _Counts],
    sources: dict[str, SceneFlowSource],
    this: _Prepared,
    following: _Prepared,
    true_m: NDArray[np.float32],
    truth: LogTruth,
) -> None:
    """Add the errors of all flows on the points off the ground of one frame."""
    frame = this.posed.frame
    labels = truth.of(frame, number=this.number)
    ground = truth.ground_of(frame, number=this.number)
    judged = np.zeros(len(frame), np.bool_)
    judged[this.prepared.valid_index] = ~this.prepared.ground
    if ground is not None:
        judged &= ground == 0
    judged &= np.linalg.norm(frame.points_m, axis=1) < MAX_RANGE_M
    judged &= np.isfinite(true_m).all(axis=1)
    if labels is None:
        return
    judged &= np.isin(labels.motion, (TRUTH_STATIC, TRUTH_DYNAMIC))
    dynamic = labels.motion[judged] == TRUTH_DYNAMIC
    expected = true_m[judged].astype(np.float64)
    next_from_this = following.prepared.beams_from_odom @ this.prepared.odom_from_beams
    by_sensor = inverse(following.posed.odom_from_sensor) @ this.posed.odom_from_sensor
    ego = transform(by_sensor, frame.points_m) - frame.points_m
    at = this.prepared.valid_index[this.prepared.judged_index]
    of_voxel = this.prepared.voxels.of_point
    for name, source in sources.items():
        # a point that the flow is not given moves with the ego-motion
        flow = np.zeros_like(ego) if name == "zero" else ego.copy()
        voxels = source(this.voxels_m, following.voxels_m, next_from_this)
        flow[at] = voxels[of_voxel]
        error = np.linalg.norm(flow[judged] - expected, axis=1)
        counts[name].add(error.astype(np.float64), expected, dynamic)


def _row(log: str, name: str, counts: Sequence[_Counts]) -> FlowEvaluation:
    sums = np.array([each.sums for each in counts])

    def by_kind(column: int) -> dict[str, float | None]:
        return {
            kind: pooled(sums[:, row, column], sums[:, row, 0]) for row, kind in enumerate(KINDS)
        }

    return FlowEvaluation(
        log=log,
        flow=name,
        frames=sum(each.frames for each in counts),
        points={kind: int(sums[:, row, 0].sum()) for row, kind in enumerate(KINDS)},
        epe_m=by_kind(1),
        strict=by_kind(2),
        relaxed=by_kind(3),
        intervals={
            kind: Interval.over_logs(sums[:, row, 1], sums[:, row, 0])
            for row, kind in enumerate(KINDS)
        },
    )
