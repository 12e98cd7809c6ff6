"""Ranking figures of one score, for the tables and the report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import Mask
from workers.lab.evaluation.failures.intervals import Interval, bootstrap
from workers.lab.evaluation.failures.retrieval import (
    BUDGETS,
    Retrieval,
    area_under,
    budget_name,
    budget_size,
    found_curve,
    precision_at_base,
    random_retrieval,
    rare_ap,
    retrieve,
)

MAIN_BUDGET: Final = 0.05
MINUTE_S: Final = 60.0
RANDOM: Final = "random"
"""Name of the random order among the baselines."""

_CURVE_POINTS: Final = 101

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Items:
    """Items to rank: scenes or objects.

    Attributes:
        logs: (N,) number of the log of each item.
        wanted: (N,) items that show a failure.
        failures: Names of the distinct failures that each item shows.
        minutes: (N,) minutes of recording that a review of each item takes.
        scenes: Number of scenes they are from.
    """

    logs: NDArray[np.int64]
    wanted: Mask
    failures: Sequence[Sequence[str]]
    minutes: Values
    scenes: int


class RankingRow(BaseModel):
    """Retrieval figures of one ranking; budgets in percent of the ranked items."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scenes: int = Field(description="Scenes of the fleet.")
    failures: int = Field(description="Distinct failures that the labels show.")
    ranked: int = Field(description="Scenes or objects that it scores.")
    ap: float | None = Field(description="Average precision; null: no failures.")
    ap_interval: Interval | None = Field(default=None, description="95 %, bootstrap over logs.")
    rare_ap: float | None = Field(
        default=None, description="Average precision, resampled to a base rate of 5 %."
    )
    rare_ap_interval: Interval | None = Field(default=None, description="Of that.")
    precision_at_base: float | None = Field(
        default=None,
        description="Precision among as many items as show a failure; it is the recall there too.",
    )
    precision_at_base_interval: Interval | None = Field(default=None, description="Of that.")
    precision_at: dict[str, float]
    precision_interval: Interval | None = Field(default=None, description="Of 5 %.")
    recall_at: dict[str, float | None]
    lift_at: dict[str, float | None] = Field(description="Precision over that of random order.")
    lift_interval: Interval | None = Field(default=None, description="Of 5 %.")
    found_per_minute_at: dict[str, float] = Field(
        description="Distinct failures found per minute of reviewed recording."
    )
    found_area: float = Field(description="Under the share of failures found, 0 to 1.")
    curve: tuple[float, ...] = Field(
        description="Share of distinct failures found after 0, 1, ... 100 % of what is ranked."
    )


def row_of(scores: Values, items: Items, *, draws: int) -> RankingRow:
    """Compute the figures of one ranking.

    Args:
        scores: (N,) scores of the items; higher ranks first.
        items: The ranked items.
        draws: Bootstrap draws; 0 computes no intervals.
    """
    main = budget_name(MAIN_BUDGET)

    def figures(drawn: NDArray[np.int64]) -> tuple[float | None, ...]:
        found = retrieve(scores[drawn], items.wanted[drawn], (MAIN_BUDGET,))
        rare = rare_ap(scores[drawn], items.wanted[drawn])
        base = precision_at_base(scores[drawn], items.wanted[drawn])
        return found.ap, found.precision_at[main], found.lift_at[main], rare, base

    names = (
        *("ap_interval", "precision_interval", "lift_interval"),
        *("rare_ap_interval", "precision_at_base_interval"),
    )
    intervals = bootstrap(items.logs.tolist(), figures, draws=draws) if draws else [None] * 5
    row = _row(
        retrieve(scores, items.wanted, BUDGETS),
        found_curve(scores, items.failures),
        items,
        **dict(zip(names, intervals, strict=True)),
    )
    more = {
        "rare_ap": _rounded(rare_ap(scores, items.wanted)),
        "precision_at_base": _rounded(precision_at_base(scores, items.wanted)),
    }
    return row.model_copy(update=more)


def random_row(items: Items) -> RankingRow:
    """Return the expected figures of a random order; each failure is shown by about one item."""
    count = len(items.wanted)
    curve = np.linspace(0.0, 1.0 if items.wanted.any() else 0.0, count + 1)
    return _row(random_retrieval(items.wanted, BUDGETS), curve, items)


def best_of(rows: Mapping[str, RankingRow]) -> str:
    """Return the name of the ranking of highest average precision."""
    return max(rows, key=lambda name: (rows[name].ap or 0.0, name))


def _row(found: Retrieval, curve: Values, items: Items, **intervals: Interval | None) -> RankingRow:
    total = len({name for names in items.failures for name in names})
    minute = float(items.minutes.mean()) if len(items.minutes) else 0.0
    rates = {}
    for budget in BUDGETS:
        looks = budget_size(budget, len(items.wanted))
        spent = looks * minute
        rates[budget_name(budget)] = round(float(curve[looks]) * total / spent, 4) if spent else 0.0
    places = np.linspace(0, len(curve) - 1, _CURVE_POINTS).round().astype(np.int64)
    return RankingRow(
        scenes=items.scenes,
        failures=total,
        ranked=len(items.wanted),
        ap=_rounded(found.ap),
        precision_at={name: round(each, 4) for name, each in found.precision_at.items()},
        recall_at={name: _rounded(each) for name, each in found.recall_at.items()},
        lift_at={name: _rounded(each) for name, each in found.lift_at.items()},
        found_per_minute_at=rates,
        found_area=round(area_under(curve), 4),
        curve=tuple(round(float(curve[place]), 4) for place in places),
        **intervals,
    )


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 4)
