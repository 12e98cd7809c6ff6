"""Curves of the loop, and the labelled scenes that a choice needs to reach the random one. Pure."""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from service.evaluation.loop_orders import RANDOM
from workers.lab.evaluation.failures.intervals import LEVEL, Interval
from workers.lab.loop.model import StreetCount

MEASURES: Final = ("moving", "unknown", "rain")
"""Intersection over union: of all moving pixels; of those of the unknown classes, where pixels of
known movers do not count; of all moving pixels on the streets with rain."""


class LoopPoint(BaseModel):
    """One trained model of the loop."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    order: str = Field(description="Order in which scenes were chosen; empty: no scene.")
    budget: int
    seed: int
    scenes: int = Field(description="Labelled scenes; fewer than the budget where no more had any.")
    with_unknown: int = Field(description="Of these, scenes with a mover of an unknown class.")
    streets: tuple[StreetCount, ...] = Field(description="Counts of each held-out street.")


class LoopRow(BaseModel):
    """A point of a curve: the mean over the seeds."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    order: str
    budget: int
    seeds: int
    scenes: float = Field(description="Labelled scenes, mean.")
    with_unknown: float = Field(description="Of these, with a mover of an unknown class, mean.")
    iou: dict[str, float] = Field(description="By measure.")
    interval: dict[str, Interval] = Field(description="95 %, bootstrap over seeds and streets.")


class LoopReach(BaseModel):
    """Labelled scenes after which a choice is as good as the random one at the largest budget."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    order: str
    measure: str
    target: float = Field(description="Value of the random choice at the largest budget.")
    scenes: float | None = Field(description="Scenes, interpolated; null: more than the budget.")
    share: float | None = Field(description="Of the largest budget.")
    share_interval: tuple[float, float | None] | None = Field(
        description="95 %, of the same draws; null at its end: more than the budget."
    )


class LoopFigure(BaseModel):
    """Result of the loop."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    fleet_scenes: int
    seeds: tuple[int, ...]
    budgets: tuple[int, ...]
    rows: tuple[LoopRow, ...]
    reach: tuple[LoopReach, ...]


_Counts = NDArray[np.float64]
_DRAWS: Final = 1000
_SUMS: Final = ("hits", "misses", "unknown_hits", "unknown_misses", "false_alarms")


def figure_of(points: Sequence[LoopPoint], *, fleet_scenes: int) -> LoopFigure:
    """Compute curves and figure from the trained models.

    A draw takes seeds and held-out streets with replacement, the same for every order.

    Args:
        points: One for each seed, order and budget, and one of budget 0 for each seed.
        fleet_scenes: Scenes of the fleet.
    """
    seeds = tuple(sorted({each.seed for each in points}))
    budgets = tuple(sorted({each.budget for each in points if each.budget}))
    orders = list(dict.fromkeys(each.order for each in points if each.budget))
    by_key = {(each.order, each.budget, each.seed): each for each in points}
    rain = np.array([each.rain for each in points[0].streets], np.bool_)
    counts = {
        (order, budget): np.stack([_counts(by_key[order, budget, seed]) for seed in seeds])
        for order, budget in [("", 0), *((order, b) for order in orders for b in budgets)]
    }
    rng = np.random.default_rng(0)
    draws = [
        (rng.integers(0, len(seeds), len(seeds)), rng.integers(0, len(rain), len(rain)))
        for _ in range(_DRAWS)
    ]
    everything = np.arange(len(seeds)), np.arange(len(rain))
    rows = []
    for (order, budget), each in counts.items():
        mine = [by_key[order, budget, seed] for seed in seeds]
        drawn = [_measures(each, rain, *draw) for draw in draws]
        rows.append(
            LoopRow(
                order=order,
                budget=budget,
                seeds=len(seeds),
                scenes=float(np.mean([point.scenes for point in mine])),
                with_unknown=round(float(np.mean([point.with_unknown for point in mine])), 2),
                iou={k: round(v, 4) for k, v in _measures(each, rain, *everything).items()},
                interval={name: _middle([one[name] for one in drawn]) for name in MEASURES},
            )
        )
    reach = [
        _reach(order, measure, counts, budgets, lambda each, draw: _measures(each, rain, *draw),
               everything, draws)
        for measure in MEASURES
        for order in orders
        if order != RANDOM and RANDOM in orders
    ]  # fmt: skip
    return LoopFigure(
        fleet_scenes=fleet_scenes, seeds=seeds, budgets=budgets, rows=tuple(rows),
        reach=tuple(reach),
    )  # fmt: skip


def scenes_to_reach(curve: Sequence[tuple[int, float]], target: float) -> float | None:
    """Return where a curve first reaches a value, linear between its points; None: nowhere.

    Args:
        curve: Budgets, rising from 0, with their values.
        target: The value to reach.
    """
    for (low, before), (high, after) in pairwise(curve):
        if before >= target:
            return float(low)
        if after >= target:
            return low + (high - low) * (target - before) / (after - before)
    return float(curve[-1][0]) if curve[-1][1] >= target else None


def _counts(point: LoopPoint) -> _Counts:
    return np.array(
        [[getattr(street, name) for name in _SUMS] for street in point.streets], np.float64
    )


def _measures(
    counts: _Counts, rain: NDArray[np.bool_], seeds: NDArray[np.int64], streets: NDArray[np.int64]
) -> dict[str, float]:
    """Return the mean over seeds of each measure, from (S, H, 5) counts."""
    drawn, wet = counts[seeds][:, streets], rain[streets]
    return {
        "moving": _iou(drawn.sum(axis=1), known=True),
        "unknown": _iou(drawn.sum(axis=1), known=False),
        "rain": _iou(drawn[:, wet].sum(axis=1), known=True),
    }


def _iou(sums: _Counts, *, known: bool) -> float:
    hits, misses, unknown_hits, unknown_misses, alarms = sums.T
    found, lost = (hits, misses) if known else (0.0, 0.0)
    whole = found + lost + unknown_hits + unknown_misses + alarms
    return float(np.mean((found + unknown_hits) / np.maximum(whole, 1.0)))


def _reach(
    order: str,
    measure: str,
    counts: Mapping[tuple[str, int], _Counts],
    budgets: Sequence[int],
    measured: Callable[[_Counts, tuple[NDArray[np.int64], NDArray[np.int64]]], dict[str, float]],
    everything: tuple[NDArray[np.int64], NDArray[np.int64]],
    draws: Sequence[tuple[NDArray[np.int64], NDArray[np.int64]]],
) -> LoopReach:
    def found(draw: tuple[NDArray[np.int64], NDArray[np.int64]]) -> tuple[float, float | None]:
        target = measured(counts[RANDOM, budgets[-1]], draw)[measure]
        curve = [(0, measured(counts["", 0], draw)[measure])]
        curve += [(b, measured(counts[order, b], draw)[measure]) for b in budgets]
        return target, scenes_to_reach(curve, target)

    target, scenes = found(everything)
    shares = sorted(
        float("inf") if one is None else one / budgets[-1] for _, one in map(found, draws)
    )
    low, high = (shares[round(q * (len(shares) - 1))] for q in ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return LoopReach(
        order=order,
        measure=measure,
        target=round(target, 4),
        scenes=None if scenes is None else round(scenes, 2),
        share=None if scenes is None else round(scenes / budgets[-1], 3),
        share_interval=None
        if low == float("inf")
        else (round(low, 3), None if high == float("inf") else round(high, 3)),
    )


def _middle(values: Sequence[float]) -> Interval:
    low, high = np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return round(float(low), 4), round(float(high), 4)
