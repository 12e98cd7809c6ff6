"""Two-stage clustering of object flow into moving objects: the rule of the paper."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from schemas.motion_rule import PER_SECOND, MotionRule


@dataclass(frozen=True, slots=True)
class ClusterSpeed:
    """Statistics of a cluster in the decision of a stage.

    Attributes:
        cluster: Its number, -1 for the noise.
        points: Its points.
        judged_points: Points in the statistics; stage 1 leaves out those over 80 km/h.
        median_m_per_s: Speed of those; 0 if there are none.
        spread: Standard deviation of their speed over its mean; 0 if there are none, NaN if their
            mean speed is zero.
        moves: Potentially dynamic (stage 1), dynamic (stage 2).
    """

    cluster: int
    points: float
    judged_points: float
    median_m_per_s: float
    spread: float
    moves: bool


@dataclass(frozen=True, slots=True, eq=False)
class TwoStageResult:
    """Clusters and decisions of both stages.

    Attributes:
        first_cluster: (N,) cluster of stage 1, -1 noise.
        candidate: (N,) member of a potentially dynamic cluster of stage 1.
        second_cluster: (N,) cluster of stage 2, -1 noise, -2 not in stage 2.
        dynamic: (N,) moving points.
        first_speeds: Every cluster of stage 1 by number, noise first if there is any.
        second_speeds: The same of stage 2.
    """

    first_cluster: NDArray[np.int64]
    candidate: Mask
    second_cluster: NDArray[np.int64]
    dynamic: Mask
    first_speeds: tuple[ClusterSpeed, ...] = ()
    second_speeds: tuple[ClusterSpeed, ...] = ()


def two_stage(
    points_m: Points,
    flow_m: NDArray[np.floating],
    *,
    dt_s: float,
    rule: MotionRule = PER_SECOND,
    weights: NDArray[np.integer] | None = None,
    first_cluster: NDArray[np.int64] | None = None,
) -> TwoStageResult:
    """Cluster points of one speed, then cluster their velocities.

    It is bug-compatible with the published code. The noise of stage 1 counts as one cluster. Points
    over 80 km/h leave the statistics of stage 1 but stay in its cluster, so that a cluster of such
    points alone is static. Stage 1 compares with <, stage 2 with <=. Where the mean speed is zero,
    nothing moves.

    Args:
        points_m: (N, 3) points off the ground, metres.
        flow_m: (N, 3) object flow over the frame interval, metres.
        dt_s: Length of the interval.
        rule: The thresholds.
        weights: (N,) number of points that each of them represents; one by default.
        first_cluster: (N,) clusters of stage 1 by the same reach and points, if they are known.
    """
    n = len(points_m)
    first = np.full(n, -1, np.int64)
    second = np.full(n, -2, np.int64)
    candidate, dynamic = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    if n == 0:
        return TwoStageResult(first, candidate, second, dynamic)
    weight = np.ones(n) if weights is None else np.asarray(weights, np.float64)
    speed = np.linalg.norm(np.asarray(flow_m, np.float64), axis=1) / dt_s

    first = (
        _dbscan(points_m, rule.reach_m, rule.min_points, weight)
        if first_cluster is None
        else first_cluster
    )
    usual = speed <= rule.max_speed_m_per_s
    first_speeds = []
    for cluster in np.unique(first):
        inside = first == cluster
        found = _speed_of(int(cluster), speed, weight, inside, inside & usual)
        found = replace(found, moves=found.judged_points > 0 and found.spread < rule.max_spread)
        candidate |= inside & found.moves
        first_speeds.append(found)
    if not candidate.any():
        return TwoStageResult(first, candidate, second, dynamic, tuple(first_speeds))

    reach_m = rule.flow_reach_m_per_s * dt_s if rule.flow_reach_m is None else rule.flow_reach_m
    second[candidate] = _dbscan(
        np.asarray(flow_m)[candidate], reach_m, rule.min_flow_points, weight[candidate]
    )
    second_speeds = []
    for cluster in np.unique(second[candidate]):
        inside = second == cluster
        found = _speed_of(int(cluster), speed, weight, inside, inside)
        fast = found.median_m_per_s >= rule.min_speed_m_per_s
        found = replace(found, moves=cluster >= 0 and fast and found.spread <= rule.max_spread)
        dynamic |= inside & found.moves
        second_speeds.append(found)
    return TwoStageResult(
        first, candidate, second, dynamic, tuple(first_speeds), tuple(second_speeds)
    )


def _speed_of(
    cluster: int,
    speed: NDArray[np.float64],
    weight: NDArray[np.float64],
    inside: Mask,
    counted: Mask,
) -> ClusterSpeed:
    """Compute the statistics of a cluster; the caller decides whether it moves."""
    speed, points, weight = speed[counted], float(weight[inside].sum()), weight[counted]
    if len(speed) == 0:
        return ClusterSpeed(cluster, points, 0.0, 0.0, 0.0, moves=False)
    median, spread = _median(speed, weight), _spread(speed, weight)
    return ClusterSpeed(cluster, points, float(weight.sum()), median, spread, moves=False)


def _dbscan(
    rows: NDArray[np.floating], reach: float, min_points: int, weight: NDArray[np.float64]
) -> NDArray[np.int64]:
    from sklearn.cluster import DBSCAN

    found = DBSCAN(eps=reach, min_samples=min_points).fit(
        np.asarray(rows, np.float64), sample_weight=weight
    )
    return np.asarray(found.labels_, np.int64)


def _spread(speed: NDArray[np.float64], weight: NDArray[np.float64]) -> float:
    """Return standard deviation over mean; NaN, which compares false, for a mean of zero."""
    mean = np.average(speed, weights=weight)
    if mean == 0.0:
        return float("nan")
    return float(np.sqrt(np.average((speed - mean) ** 2, weights=weight)) / mean)


def _median(speed: NDArray[np.float64], weight: NDArray[np.float64]) -> float:
    if (weight == 1.0).all():
        return float(np.median(speed))
    order = np.argsort(speed, kind="stable")
    reached = np.cumsum(weight[order])
    return float(speed[order[np.searchsorted(reached, 0.5 * reached[-1])]])
