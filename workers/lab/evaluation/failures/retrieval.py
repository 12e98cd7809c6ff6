"""How well a ranking finds what was asked for; what is equally ranked is taken in random order."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import average_precision_score

from schemas.arrays import Mask

BUDGETS: Final = (0.005, 0.01, 0.02, 0.05, 0.10)
_PERCENT: Final = 100.0

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Retrieval:
    """How good a ranking is.

    Attributes:
        ap: Average precision; None where nothing was to be found.
        precision_at: By budget in percent, `"5"`: share of what is looked at that was asked for.
        recall_at: Share of what was asked for that is looked at.
        lift_at: Precision over that of a random order.
    """

    ap: float | None
    precision_at: dict[str, float]
    recall_at: dict[str, float | None]
    lift_at: dict[str, float | None]


def name_of(budget: float) -> str:
    """Name a budget as tables do: `0.5`, `5`."""
    return f"{_PERCENT * budget:g}"


def retrieve(scores: Values, wanted: Mask, budgets: Sequence[float] = BUDGETS) -> Retrieval:
    """Judge a ranking.

    Args:
        scores: (N,) of each item, higher is looked at first.
        wanted: (N,) which were to be found.
        budgets: Shares of the items that are looked at; one item at least.
    """
    count = len(scores)
    base = float(wanted.mean()) if count else 0.0
    found = {name_of(b): found_within(scores, wanted, looked_at(b, count)) for b in budgets}
    looks = {name_of(b): looked_at(b, count) for b in budgets}
    precision = {name: hits / looks[name] if looks[name] else 0.0 for name, hits in found.items()}
    total = int(wanted.sum())
    return Retrieval(
        ap=float(average_precision_score(wanted, scores)) if total else None,
        precision_at=precision,
        recall_at={name: hits / total if total else None for name, hits in found.items()},
        lift_at={name: each / base if base else None for name, each in precision.items()},
    )


def random_retrieval(wanted: Mask, budgets: Sequence[float] = BUDGETS) -> Retrieval:
    """What a random order is expected to give.

    The expected average precision of N items of which R are wanted is
    `((R - 1) / (N - 1) (N - H) + H) / N` with `H` the N-th harmonic number.
    """
    count, total = len(wanted), int(wanted.sum())
    base = total / count if count else 0.0
    ap = None
    if total:
        harmonic = float(np.sum(1.0 / np.arange(1, count + 1)))
        rest = (total - 1) / (count - 1) if count > 1 else 1.0
        ap = (rest * (count - harmonic) + harmonic) / count
    names = [name_of(budget) for budget in budgets]
    looks = [looked_at(budget, count) / count if count else 0.0 for budget in budgets]
    return Retrieval(
        ap=ap,
        precision_at=dict.fromkeys(names, base),
        recall_at=dict(zip(names, looks if total else [None] * len(names), strict=True)),
        lift_at=dict.fromkeys(names, 1.0 if base else None),
    )


def looked_at(budget: float, count: int) -> int:
    """How many items a budget pays for."""
    return min(count, max(1, round(budget * count)))


def found_within(scores: Values, wanted: Mask, looks: int) -> float:
    """How many wanted items the first so many hold, in the mean over orders of equal ones."""
    if not looks:
        return 0.0
    edge = np.sort(scores)[::-1][looks - 1]
    above, equal = scores > edge, scores == edge
    share = (looks - int(above.sum())) / int(equal.sum())
    return float(wanted[above].sum() + share * wanted[equal].sum())


def order_of(scores: Values, seed: int = 0) -> NDArray[np.int64]:
    """One order of the items, best first; equal ones as a seed shuffles them."""
    shuffled = np.random.default_rng(seed).permutation(len(scores))
    order: NDArray[np.int64] = shuffled[np.argsort(-scores[shuffled], kind="stable")]
    return order


def found_curve(scores: Values, failures: Sequence[Sequence[str]]) -> Values:
    """How many distinct failures are found after each item.

    Args:
        scores: (N,) of each item.
        failures: The names of the failures that each item shows.

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
    """Area under a found curve over the share of items looked at, 0 to 1."""
    if len(curve) < 2:
        return 0.0
    return float(np.trapezoid(curve, dx=1.0 / (len(curve) - 1)))
