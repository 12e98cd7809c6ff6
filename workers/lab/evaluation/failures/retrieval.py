"""Retrieval figures of a ranking: average precision, precision at k; ties in random order."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import average_precision_score

from schemas.arrays import Mask

BUDGETS: Final = (0.005, 0.01, 0.02, 0.05, 0.10)
RARE_BASE: Final = 0.05
"""Base rate of failures to which average precision is resampled."""

_PERCENT: Final = 100.0

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Retrieval:
    """Retrieval figures.

    Attributes:
        ap: Average precision; None without wanted items.
        precision_at: Share of the items inside the budget that are wanted, by budget in percent,
            `"5"`.
        recall_at: Share of the wanted items that are inside the budget.
        lift_at: Precision over that of a random order.
    """

    ap: float | None
    precision_at: dict[str, float]
    recall_at: dict[str, float | None]
    lift_at: dict[str, float | None]


def budget_name(budget: float) -> str:
    """Name a budget as tables do: `0.5`, `5`."""
    return f"{_PERCENT * budget:g}"


def retrieve(scores: Values, wanted: Mask, budgets: Sequence[float] = BUDGETS) -> Retrieval:
    """Compute the retrieval figures of a ranking.

    Args:
        scores: (N,) scores of the items, higher ranks first.
        wanted: (N,) items to retrieve.
        budgets: Shares of the items that are reviewed; at least one item.
    """
    count = len(scores)
    base = float(wanted.mean()) if count else 0.0
    found = {budget_name(b): found_within(scores, wanted, budget_size(b, count)) for b in budgets}
    looks = {budget_name(b): budget_size(b, count) for b in budgets}
    precision = {name: hits / looks[name] if looks[name] else 0.0 for name, hits in found.items()}
    total = int(wanted.sum())
    return Retrieval(
        ap=float(average_precision_score(wanted, scores)) if total else None,
        precision_at=precision,
        recall_at={name: hits / total if total else None for name, hits in found.items()},
        lift_at={name: each / base if base else None for name, each in precision.items()},
    )


def random_retrieval(wanted: Mask, budgets: Sequence[float] = BUDGETS) -> Retrieval:
    """Return the expected figures of a random order.

    The expected average precision is `((R-1)/(N-1) (N-H) + H)/N`, for R wanted of N items, with `H`
    the N-th harmonic number.
    """
    count, total = len(wanted), int(wanted.sum())
    base = total / count if count else 0.0
    ap = None
    if total:
        harmonic = float(np.sum(1.0 / np.arange(1, count + 1)))
        rest = (total - 1) / (count - 1) if count > 1 else 1.0
        ap = (rest * (count - harmonic) + harmonic) / count
    names = [budget_name(budget) for budget in budgets]
    looks = [budget_size(budget, count) / count if count else 0.0 for budget in budgets]
    return Retrieval(
        ap=ap,
        precision_at=dict.fromkeys(names, base),
        recall_at=dict(zip(names, looks if total else [None] * len(names), strict=True)),
        lift_at=dict.fromkeys(names, 1.0 if base else None),
    )


def rare_ap(scores: Values, wanted: Mask, base: float = RARE_BASE) -> float | None:
    """Return the average precision as if wanted items had another base rate; None without both.

    Items that are not wanted get the weight that makes the wanted ones this share of all.
    """
    total, rest = int(wanted.sum()), int((~wanted).sum())
    if not total or not rest:
        return None
    weight = np.where(wanted, 1.0, total * (1.0 - base) / (base * rest))
    return float(average_precision_score(wanted, scores, sample_weight=weight))


def precision_at_base(scores: Values, wanted: Mask) -> float | None:
    """Return the precision among as many items as are wanted, which is the recall there too."""
    total = int(wanted.sum())
    return found_within(scores, wanted, total) / total if total else None


def budget_size(budget: float, count: int) -> int:
    """Return the number of items in a budget, at least one."""
    return min(count, max(1, round(budget * count)))


def found_within(scores: Values, wanted: Mask, looks: int) -> float:
    """Return the mean number of wanted items among the first ones, over all orders of ties."""
    if not looks:
        return 0.0
    edge = np.sort(scores)[::-1][looks - 1]
    above, equal = scores > edge, scores == edge
    share = (looks - int(above.sum())) / int(equal.sum())
    return float(wanted[above].sum() + share * wanted[equal].sum())


def order_of(scores: Values, seed: int = 0) -> NDArray[np.int64]:
    """Return one order of the items, best first; a seed shuffles ties."""
    shuffled = np.random.default_rng(seed).permutation(len(scores))
    order: NDArray[np.int64] = shuffled[np.argsort(-scores[shuffled], kind="stable")]
    return order


def found_curve(scores: Values, failures: Sequence[Sequence[str]]) -> Values:
    """Compute the share of distinct failures found after each item.

    Args:
        scores: (N,) scores of the items.
        failures: Names of the failures that each item shows.

    Returns:
        (N + 1,) share of all distinct failures found after 0, 1, ... items; zeros without any.
    """
    total = len({name for names in failures for name in names})
    curve, found = np.zeros(len(scores) + 1), set[str]()
    for place, item in enumerate(order_of(scores).tolist(), start=1):
        found |= set(failures[item])
        curve[place] = len(found) / total if total else 0.0
    return curve


def area_under(curve: Values) -> float:
    """Integrate a found curve over the share of reviewed items, 0 to 1."""
    if len(curve) < 2:
        return 0.0
    return float(np.trapezoid(curve, dx=1.0 / (len(curve) - 1)))
