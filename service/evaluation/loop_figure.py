"""Curves of the loop, and the labelled scenes that a choice needs to reach the random one. Pure."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from service.evaluation.loop_orders import RANDOM
from workers.lab.evaluation.failures.intervals import LEVEL, Interval
from workers.lab.loop.model import StreetCount

MEASURES: Final = ("moving", "unknown", "rain")
"""Share of pixels found, where `ALARMS` of the static ones are called moving: of all moving pixels;
of those of the unknown classes; of all moving pixels on the streets with rain. So models are
compared that are equally cautious, and false alarms elsewhere do not drown a rare class."""

ALARMS: Final = 0.02
"""Share of the static pixels that are called moving."""


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
    found: dict[str, float] = Field(description="Share of the pixels, by measure.")
    interval: dict[str, Interval] = Field(description="95 %, bootstrap over seeds and streets.")
    over_random: dict[str, Interval] = Field(
        description="95 % of the difference to the random choice of equally many scenes, by draw."
    )


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
_Measures = dict[str, float]


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
    measured = {
        key: [_measures(each, rain, *draw) for draw in (everything, *draws)]
        for key, each in counts.items()
    }
    rows = []
    for (order, budget), (value, *drawn) in measured.items():
        mine = [by_key[order, budget, seed] for seed in seeds]
        chance = measured.get((RANDOM, budget), [])[1:] if order != RANDOM else []
        rows.append(
            LoopRow(
                order=order,
                budget=budget,
                seeds=len(seeds),
                scenes=float(np.mean([point.scenes for point in mine])),
                with_unknown=round(float(np.mean([point.with_unknown for point in mine])), 2),
                found={name: round(value[name], 4) for name in MEASURES},
                interval={name: _middle([one[name] for one in drawn]) for name in MEASURES},
                over_random={
                    name: _middle([a[name] - b[name] for a, b in zip(drawn, chance, strict=True)])
                    for name in (MEASURES if chance else ())
                },
            )
        )
    reach = [
        _reach(order, measure, measured, budgets)
        for measure in MEASURES
        for order in orders
        if order != RANDOM and RANDOM in orders
    ]
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
    """Return (H, 3, B) counts of the streets: known and unknown movers, static pixels."""
    return np.array(
        [[each.known_moving, each.unknown_moving, each.static] for each in point.streets],
        np.float64,
    )


def _measures(
    counts: _Counts, rain: NDArray[np.bool_], seeds: NDArray[np.int64], streets: NDArray[np.int64]
) -> _Measures:
    """Return the mean over seeds of each measure, from (S, H, 3, B) counts."""
    drawn, wet = counts[seeds][:, streets], rain[streets]
    whole, in_rain = drawn.sum(axis=1), drawn[:, wet].sum(axis=1)
    return {
        "moving": _found(whole[:, 0] + whole[:, 1], whole[:, 2]),
        "unknown": _found(whole[:, 1], whole[:, 2]),
        "rain": _found(in_rain[:, 0] + in_rain[:, 1], in_rain[:, 2]),
    }


def _found(moving: _Counts, static: _Counts) -> float:
    """Return the share of moving pixels above the score of which `ALARMS` static ones are.

    Args:
        moving: (S, B) counts by score, rising.
        static: (S, B) the same of static pixels.
    """
    shares = []
    for mine, others in zip(moving, static, strict=True):
        above = np.concatenate([[0.0], mine[::-1].cumsum()]) / max(mine.sum(), 1.0)
        alarms = np.concatenate([[0.0], others[::-1].cumsum()]) / max(others.sum(), 1.0)
        shares.append(np.interp(ALARMS, alarms, above))
    return float(np.mean(shares))


def _reach(
    order: str,
    measure: str,
    measured: Mapping[tuple[str, int], Sequence[_Measures]],
    budgets: Sequence[int],
) -> LoopReach:
    def found(draw: int) -> tuple[float, float | None]:
        target = measured[RANDOM, budgets[-1]][draw][measure]
        curve = [(0, measured["", 0][draw][measure])]
        curve += [(b, measured[order, b][draw][measure]) for b in budgets]
        return target, scenes_to_reach(curve, target)

    target, scenes = found(0)
    shares = sorted(
        float("inf") if one is None else one / budgets[-1]
        for _, one in map(found, range(1, _DRAWS + 1))
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
