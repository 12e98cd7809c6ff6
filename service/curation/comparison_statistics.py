"""Statistics of a comparison: rates, intervals and tests, all by log. Pure.

Scenes of one log depend on each other, so a log is the unit everywhere. Intervals are those of
cluster-robust standard errors. Tests exchange whole logs between the versions: under the hypothesis
that both are equal, every assignment of logs to versions is equally likely.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np
from numpy.typing import NDArray

EXCHANGES: Final = 20_000
"""Random assignments of logs to versions; the smallest p is one in as many."""

MOST_EXCHANGED: Final = 2_000
"""Logs up to which assignments are drawn; with more the normal limit of the same test is used."""

AT_ONCE: Final = 250
"""Assignments in memory at a time."""

SEED: Final = 20_260_302
"""Seed of the assignments, so that equal requests have equal answers."""

LEVEL: Final = 0.05
"""Probability of an error, over all comparisons together."""

Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Tested:
    """Rates of G groups on both sides, and their difference.

    Attributes:
        rate_a: (G,) tracks per hour of A.
        rate_b: (G,) tracks per hour of B.
        error_a: (G,) standard error of `rate_a`, by log.
        error_b: (G,) standard error of `rate_b`, by log.
        error: (G,) standard error of the difference, by log.
        p: (G,) two-sided p of the exchange of logs.
    """

    rate_a: Numbers
    rate_b: Numbers
    error_a: Numbers
    error_b: Numbers
    error: Numbers
    p: Numbers


@dataclass(frozen=True, slots=True, eq=False)
class Road:
    """Logs on one kind of road.

    Attributes:
        hours: (L,) hours of each log driven on it.
        counts: (L, G) tracks of each log on it, by group.
    """

    hours: Numbers
    counts: Numbers


def over_roads(roads: Sequence[Road], is_b: NDArray[np.bool_], *, tolerance: float) -> Tested:
    """Compare the logs of two versions over the kinds of road that both drove.

    The rates of the roads are added with the weights of Mantel and Haenszel. The test exchanges
    what each log has in excess of the common rate of its roads.

    Args:
        roads: Roads that both versions drove; at least one.
        is_b: (L,) True for logs of B.
        tolerance: Share by which B may exceed A.
    """
    hours = np.array([[road.hours[~is_b].sum(), road.hours[is_b].sum()] for road in roads])
    weights = hours.prod(axis=1) / hours.sum(axis=1)
    weights /= weights.sum()
    logs, groups = len(is_b), roads[0].counts.shape[1]
    rates, excess = np.zeros((2, groups)), np.zeros((logs, groups))
    influence = np.zeros((logs, groups))
    allowed = np.where(is_b, 1.0 + tolerance, 1.0)
    for weight, road, both in zip(weights, roads, hours, strict=True):
        for side, mine in enumerate((~is_b, is_b)):
            rate = road.counts[mine].sum(axis=0) / both[side]
            rates[side] += weight * rate
            off = road.counts[mine] - np.outer(road.hours[mine], rate)
            influence[mine] += weight * off / both[side]
        expected = road.hours * allowed
        common = road.counts.sum(axis=0) / expected.sum()
        excess += road.counts - np.outer(expected, common)
    errors = [_error(influence[mine]) for mine in (~is_b, is_b)]
    return Tested(
        rate_a=rates[0],
        rate_b=rates[1],
        error_a=errors[0],
        error_b=errors[1],
        error=np.hypot(errors[0], errors[1]),
        p=_exchange(excess, is_b),
    )


def over_logs(hours: Numbers, counts_a: Numbers, counts_b: Numbers, *, tolerance: float) -> Tested:
    """Compare two versions over the very same logs.

    The test exchanges the two versions of a log.

    Args:
        hours: (L,) hours of each log.
        counts_a: (L, G) tracks of A.
        counts_b: (L, G) tracks of B, over the same hours.
        tolerance: Share by which B may exceed A.
    """
    total = hours.sum()
    rate_a, rate_b = counts_a.sum(axis=0) / total, counts_b.sum(axis=0) / total
    off_a = (counts_a - np.outer(hours, rate_a)) / total
    off_b = (counts_b - np.outer(hours, rate_b)) / total
    return Tested(
        rate_a=rate_a,
        rate_b=rate_b,
        error_a=_error(off_a),
        error_b=_error(off_b),
        error=_error(off_b - off_a),
        p=_flip(counts_b - (1.0 + tolerance) * counts_a),
    )


def _error(influence: Numbers) -> Numbers:
    """Return the standard error of a sum over logs, from the influence of each log on it."""
    logs = len(influence)
    if logs < 2:
        return np.full(influence.shape[1], np.inf)
    found: Numbers = np.sqrt((influence**2).sum(axis=0) * logs / (logs - 1))
    return found


def _exchange(excess: Numbers, is_b: NDArray[np.bool_]) -> Numbers:
    """Return two-sided p of the sum over B, under exchange of logs between the versions."""
    logs, count = len(is_b), int(is_b.sum())
    centred = excess - excess.mean(axis=0)
    found = np.abs(centred[is_b].sum(axis=0))
    if logs > MOST_EXCHANGED:
        spread = (centred**2).sum(axis=0) * count * (logs - count) / (logs * (logs - 1))
        return _of_normal(found, np.sqrt(spread))
    rng = np.random.default_rng(SEED)

    def draw(size: int) -> Numbers:
        order = rng.random((size, logs)).argpartition(count - 1, axis=1)[:, :count]
        drawn = np.zeros((size, logs))
        np.put_along_axis(drawn, order, 1.0, axis=1)
        return drawn

    return _share_as_far(found, [draw(AT_ONCE) @ centred for _ in range(EXCHANGES // AT_ONCE)])


def _flip(difference: Numbers) -> Numbers:
    """Return two-sided p of the sum over logs, under exchange of the versions within each log."""
    found = np.abs(difference.sum(axis=0))
    if len(difference) > MOST_EXCHANGED:
        return _of_normal(found, np.sqrt((difference**2).sum(axis=0)))
    rng = np.random.default_rng(SEED)
    sums = [
        rng.choice((-1.0, 1.0), size=(AT_ONCE, len(difference))) @ difference
        for _ in range(EXCHANGES // AT_ONCE)
    ]
    return _share_as_far(found, sums)


def _share_as_far(found: Numbers, drawn: Sequence[Numbers]) -> Numbers:
    """Return the share of drawn sums that are as far from zero as the found ones."""
    far = sum((np.abs(each) >= found - 1e-9).sum(axis=0) for each in drawn)
    return np.asarray((1.0 + far) / (1.0 + EXCHANGES), np.float64)


def _of_normal(found: Numbers, spread: Numbers) -> Numbers:
    normal = NormalDist()
    return np.array(
        [
            2.0 * normal.cdf(-value / scale) if scale > 0 else 1.0
            for value, scale in zip(found.tolist(), spread.tolist(), strict=True)
        ]
    )


def holm(p: Numbers) -> tuple[Numbers, Numbers]:
    """Correct p values by Holm's method.

    Returns:
        (G,) corrected p, and (G,) level at which each comparison is made: `LEVEL` over the number
        of comparisons that are not more significant than it.
    """
    count, order = len(p), np.argsort(p, kind="stable")
    left = count - np.arange(count)
    corrected, levels = np.empty(count), np.empty(count)
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(left * p[order]))
    levels[order] = LEVEL / left
    return corrected, levels


def quantile(level: float) -> float:
    """Return the quantile of the normal distribution for a two-sided interval of this level."""
    return NormalDist().inv_cdf(1.0 - level / 2.0)
