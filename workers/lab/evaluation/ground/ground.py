"""Ground metrics: precision, recall and IoU of ground points, and the error of its height."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import tee
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import Mask, Points
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from workers.lab.evaluation.figures import Interval, pooled
from workers.lab.evaluation.ground.sources import FLOORS, GroundAnswer, build
from workers.lab.evaluation.posed_frames import posed_frames
from workers.lab.evaluation.truth.truth import TruthUnusableError, logs_with_truth
from workers.lidar.beam_table import MIN_RANGE_M
from workers.lidar.preprocessing import MAX_RANGE_M
from workers.parts.registry import build_odometry

DEFAULT: Final = ("ground", "salsanext:ground")

CELL_M: Final = 1.0
"""Side of a cell in which heights are compared, metres, as in GndNet's map."""

LEAST_POINTS: Final = 3
"""Points of the ground that a cell needs for a height."""

_STATED: Final = (0, 1)


class GroundEvaluation(BaseModel):
    """Metrics of one method on one log, or on all; points between 2.5 and 80 m."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    log: str = Field(description="Log id, or `all`.")
    method: str = Field(description="Name of the method.")
    frames: int = Field(description="Frames whose truth has ground.")
    points: int = Field(description="Points whose truth is known.")
    precision: float | None = Field(description="Of points called ground, those that are.")
    recall: float | None = Field(description="Of ground points, those called ground.")
    iou: float | None = Field(description="Intersection over union of ground points.")
    height_error_m: dict[str, float] = Field(
        description="Median and 90 % quantile of the error of the height of a cell, metres."
    )
    cells_without_height: float | None = Field(
        description="Share of the cells of true ground in which the method has no height."
    )
    interval: Interval | None = Field(
        description="Bootstrap of the share of right points over logs, 95 %; null below three."
    )


@dataclass(slots=True)
class _Counts:
    frames: int = 0
    hits: int = 0
    called: int = 0
    true: int = 0
    right: int = 0
    points: int = 0
    cells: int = 0
    errors_m: list[NDArray[np.float32]] = field(default_factory=list)

    def add(self, answer: GroundAnswer, points_m: Points, truth: NDArray[np.uint8]) -> None:
        """Add one frame."""
        across = np.linalg.norm(points_m, axis=1)
        judged = np.isin(truth, _STATED) & (across > MIN_RANGE_M) & (across < MAX_RANGE_M)
        called, true = answer.ground[judged], truth[judged] == 1
        self.frames += 1
        self.hits += int(np.count_nonzero(called & true))
        self.called += int(np.count_nonzero(called))
        self.true += int(np.count_nonzero(true))
        self.right += int(np.count_nonzero(called == true))
        self.points += len(true)
        places, expected = heights_of(points_m, judged & (truth == 1))
        self.cells += len(places)
        self.errors_m.append(height_errors(answer, points_m, judged, places, expected))


def heights_of(points_m: Points, ground: Mask) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the cells with enough ground points, (C, 2), and the median height in each, (C,)."""
    cells = np.floor(points_m[ground, :2] / CELL_M).astype(np.int64)
    if not len(cells):
        return np.empty((0, 2), np.int64), np.empty(0)
    distinct, of_point, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    of_point = of_point.ravel()
    heights = points_m[ground, 2].astype(np.float64)
    order = np.lexsort((heights, of_point))
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    middle = heights[order][first + count // 2]
    enough = count >= LEAST_POINTS
    return distinct[enough], middle[enough]


def height_errors(
    answer: GroundAnswer,
    points_m: Points,
    judged: Mask,
    places: NDArray[np.int64],
    expected: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Return the errors of heights, (K,) metres; cells without a height are left out."""
    if answer.surface_m is not None:
        found = answer.surface_m(np.asarray((places + 0.5) * CELL_M, np.float64))
    else:
        known, heights = heights_of(points_m, judged & answer.ground)
        of_cell = {(int(x), int(y)): z for (x, y), z in zip(known, heights, strict=True)}
        found = np.array([of_cell.get((int(x), int(y)), np.nan) for x, y in places])
    error = np.abs(found - expected)
    return error[np.isfinite(error)].astype(np.float32)


def evaluate_ground(
    bucket_url: str,
    truth: Path,
    *,
    frames: range,
    settings: MiningSettings,
    methods: Sequence[str] = DEFAULT,
    on_progress: Callable[[int], None] = lambda done: None,
) -> tuple[list[GroundEvaluation], list[str]]:
    """Evaluate ground methods on every log of a bucket whose truth has ground.

    Args:
        bucket_url: URL or path of the bucket.
        truth: Folder of truth: that of `x/y.mcap` is in `x/y`.
        frames: Frames to evaluate, counted in each log.
        settings: Names of the parts, and ingest settings.
        methods: Names of methods in addition to the floors.
        on_progress: Called with the number of frames done.

    Returns:
        Rows of each log and of all logs, the floors last; and the logs without true ground.

    Raises:
        TruthUnusableError: If no log has true ground.
        UnknownPartError: If a method does not exist.
    """
    built = {name: build(name, settings) for name in dict.fromkeys([*methods, *FLOORS])}
    read_as = settings
    if "recorded:ground" in built:
        read_as = settings.model_copy(update={"supervised": "recorded:ground"})
    bucket, odometry = open_bucket(bucket_url), build_odometry(settings.odometry)
    per_log: dict[str, dict[str, _Counts]] = {}
    without, done = [], 0
    for recording, found in logs_with_truth(bucket, truth):
        counts = {name: _Counts() for name in built}
        read = posed_frames(
            bucket, recording, found, odometry=odometry, settings=read_as, frames=frames
        )
        numbered, *inputs = tee(read, 1 + len(built))
        answers = [
            method(posed for _, posed in given)
            for method, given in zip(built.values(), inputs, strict=True)
        ]
        for (number, posed), *of_frame in zip(numbered, *answers, strict=True):
            stated = found.ground_of(posed.frame, number=number)
            done += 1
            on_progress(done)
            if stated is None:
                continue
            for name, answer in zip(built, of_frame, strict=True):
                counts[name].add(answer, posed.frame.points_m, stated)
        if any(each.true for each in counts.values()):
            per_log[recording.log_id] = counts
        else:
            without.append(recording.log_id)
    if not per_log:
        raise TruthUnusableError(
            f"no log of {bucket.url} has true ground in {truth}: arrays `ground`, or classes of "
            "points; deploy/TRUTH.md defines the format"
        )
    rows = [_row(log, name, [counts[name]]) for log, counts in per_log.items() for name in built]
    rows += [_row("all", name, [each[name] for each in per_log.values()]) for name in built]
    return rows, without


def _row(log: str, name: str, counts: Sequence[_Counts]) -> GroundEvaluation:
    hits, called, true = (
        sum(getattr(each, what) for each in counts) for what in ("hits", "called", "true")
    )
    errors = np.concatenate([error for each in counts for error in each.errors_m])
    cells = sum(each.cells for each in counts)
    heights = {}
    if len(errors):
        heights = {
            "median": round(float(np.median(errors)), 4),
            "q90": round(float(np.quantile(errors, 0.9)), 4),
        }
    return GroundEvaluation(
        log=log,
        method=name,
        frames=sum(each.frames for each in counts),
        points=sum(each.points for each in counts),
        precision=pooled(hits, called),
        recall=pooled(hits, true),
        iou=pooled(hits, called + true - hits),
        height_error_m=heights,
        cells_without_height=pooled(cells - len(errors), cells),
        interval=Interval.over_logs(
            [each.right for each in counts], [each.points for each in counts]
        ),
    )
