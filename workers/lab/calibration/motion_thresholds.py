"""Calibration of the two-stage rule: overlap of speeds, spread of instances, grid of thresholds.

Source: the thresholds of arXiv 2407.14306, which its authors chose from the speeds of static and
dynamic points and from the normalised standard deviation of true instances.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.motion_rule import KMH, PER_SECOND, MotionRule
from workers.lab.calibration.motion_samples import MotionSample
from workers.paper.two_stage_clustering import TwoStageResult, two_stage

SPEED_EDGES: Final = np.concatenate((np.arange(0, 40.5, 0.5), [np.inf])) * KMH
"""Edges of the histogram of speeds, m/s: half a km/h each up to 40 km/h, and the rest."""

MIN_INSTANCE_POINTS: Final = 10
"""Voxels of a true instance whose spread is meaningful."""

SPREADS: Final = (0.06, 0.12, 0.25, 0.5)
FLOW_REACHES_M_PER_S: Final = (0.15, 0.3, 0.6)
MIN_SPEEDS_M_PER_S: Final = tuple(speed * KMH for speed in (1, 2, 3, 4, 6, 8))
"""Candidates of the grid search; the published thresholds are among them."""


@dataclass(frozen=True, slots=True, eq=False)
class SpeedOverlap:
    """Histograms of the speeds of static and of dynamic points.

    Attributes:
        static: (B,) share of static points in each bin of `SPEED_EDGES`.
        dynamic: (B,) the same of dynamic points.
        overlap: Common area of the two, 0 (a threshold separates them) to 1 (equal).
    """

    static: NDArray[np.float64]
    dynamic: NDArray[np.float64]
    overlap: float


@dataclass(frozen=True, slots=True)
class InstanceSpread:
    """Speed of one true instance in one frame: its median and its normalised deviation."""

    dynamic: bool
    points: int
    median_m_per_s: float
    spread: float


@dataclass(frozen=True, slots=True)
class GridPoint:
    """One candidate of the grid, with points counted over all samples.

    Attributes:
        rule: The thresholds.
        hits: Dynamic points that the rule labels dynamic.
        false: Static points that it labels dynamic.
        missed: Dynamic points that it labels static.
    """

    rule: MotionRule
    hits: int
    false: int
    missed: int

    @property
    def iou(self) -> float:
        """Dynamic IoU; 0 without any dynamic point or label."""
        whole = self.hits + self.false + self.missed
        return self.hits / whole if whole else 0.0


def speed_overlap(samples: Sequence[MotionSample]) -> SpeedOverlap:
    """Compare the speeds of static and dynamic points, each point counted once."""
    static, dynamic = np.zeros(len(SPEED_EDGES) - 1), np.zeros(len(SPEED_EDGES) - 1)
    for sample in samples:
        for total, chosen in (
            (static, sample.known & ~sample.dynamic),
            (dynamic, sample.known & sample.dynamic),
        ):
            counted, _ = np.histogram(
                sample.speed_m_per_s[chosen], SPEED_EDGES, weights=sample.weights[chosen]
            )
            total += counted
    shares = [total / max(total.sum(), 1.0) for total in (static, dynamic)]
    return SpeedOverlap(shares[0], shares[1], float(np.minimum(*shares).sum()))


def instance_spreads(samples: Sequence[MotionSample]) -> list[InstanceSpread]:
    """Compute the normalised standard deviation of the speed of each true instance per frame."""
    found = []
    for sample in samples:
        speed = sample.speed_m_per_s
        for track in np.unique(sample.track[sample.known & (sample.track >= 0)]):
            inside = sample.known & (sample.track == track)
            if np.count_nonzero(inside) < MIN_INSTANCE_POINTS:
                continue
            weights = sample.weights[inside]
            mean = float(np.average(speed[inside], weights=weights))
            deviation = float(np.sqrt(np.average((speed[inside] - mean) ** 2, weights=weights)))
            found.append(
                InstanceSpread(
                    bool(sample.dynamic[inside].mean() > 0.5),
                    int(weights.sum()),
                    float(np.median(speed[inside])),
                    deviation / mean if mean else float("inf"),
                )
            )
    return found


def search_thresholds(
    samples: Sequence[MotionSample],
    *,
    base: MotionRule = PER_SECOND,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[GridPoint]:
    """Count hits and errors of every candidate of the grid, best IoU first.

    Stage 1 clusters each frame once, stage 2 once for each pair of spread and reach. The slowest
    accepted speed is applied to the clusters of each run.
    """
    pairs = list(product(SPREADS, FLOW_REACHES_M_PER_S))
    counts = np.zeros((len(pairs), len(MIN_SPEEDS_M_PER_S), 3), np.int64)
    for done, sample in enumerate(samples):
        first = None
        for place, (spread, reach) in enumerate(pairs):
            update = {
                **{"max_spread": spread, "flow_reach_m_per_s": reach},
                **{"flow_reach_m": None, "min_speed_m_per_s": 0.0},
            }
            rule = base.model_copy(update=update)
            found = two_stage(
                *(sample.places_m, sample.flow_m),
                dt_s=sample.dt_s,
                rule=rule,
                weights=sample.weights,
                first_cluster=first,
            )
            first = found.first_cluster
            counts[place] += _counts(sample, found)
        on_progress(done + 1, len(samples))
    grid = [
        GridPoint(
            base.model_copy(
                update={
                    **{"max_spread": spread, "flow_reach_m_per_s": reach},
                    **{"flow_reach_m": None, "min_speed_m_per_s": speed},
                }
            ),
            *(int(count) for count in counts[place, column]),
        )
        for place, (spread, reach) in enumerate(pairs)
        for column, speed in enumerate(MIN_SPEEDS_M_PER_S)
    ]
    return sorted(grid, key=lambda each: -each.iou)


def _counts(sample: MotionSample, found: TwoStageResult) -> NDArray[np.int64]:
    """Return (S, 3) hits, false and missed points for each slowest accepted speed."""
    counts = np.zeros((len(MIN_SPEEDS_M_PER_S), 3), np.int64)
    medians = {each.cluster: each.median_m_per_s for each in found.second_speeds if each.moves}
    speed = np.array([medians.get(int(one), -1.0) for one in found.second_cluster])
    static, dynamic = sample.known & ~sample.dynamic, sample.known & sample.dynamic
    for column, least in enumerate(MIN_SPEEDS_M_PER_S):
        labelled = found.dynamic & (speed >= least)
        counts[column] = [
            int(sample.weights[chosen].sum())
            for chosen in (labelled & dynamic, labelled & static, ~labelled & dynamic)
        ]
    return counts
