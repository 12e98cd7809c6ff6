"""Effect of a learned ranking on verdicts that it did not see: precision and calibration. Pure."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import Count, Finite
from schemas.score import Share

FOLDS: Final = 10
"""Groups of logs, each of which is predicted from the others."""

_DRAWS: Final = 1000
"""Draws of the bootstrap; the bounds of an interval are then known to about 1 % of its mass."""

_SEED: Final = 20261502
"""Seed of the draws, so that the same verdicts give the same answer."""

_FIRST: Final = 30
"""Scenes at the top whose precision is measured; a third of the verdicts where these are fewer."""

_BINS: Final = 5
"""Bins of equal width of the predicted chances."""

_STRICT: Final = ConfigDict(frozen=True, extra="forbid")

Column = NDArray[np.float64]
"""(N,) one number per judged scene."""


class WithAndWithout(BaseModel):
    """A figure of the learned ranking and of that by the score."""

    model_config = _STRICT

    score: Share | None = Field(description="By the score; null: it is undefined.")
    learned: Share | None = Field(description="By what verdicts teach, on verdicts it did not see.")
    low: Finite | None = Field(description="Of the difference: lower bound of 95 %, by log.")
    high: Finite | None = Field(description="Upper bound.")


class Reliability(BaseModel):
    """Judged scenes whose predicted chances are in one bin."""

    model_config = _STRICT

    scenes: Count
    predicted: Share = Field(description="Mean of the chances.")
    right: Share = Field(description="Share on which the supervised stream is wrong.")


class LearnedEffect(BaseModel):
    """Effect of verdicts on the ranking, cross-validated by log."""

    model_config = _STRICT

    verdicts: Count = Field(description="Scenes with a verdict that decides.")
    right: Count = Field(description="Of these, the supervised stream is wrong.")
    logs: Count = Field(description="Their logs.")
    is_used: bool = Field(
        description="The interval of the gain in average precision is above 0: the ranking is the "
        "learned one."
    )
    average_precision: WithAndWithout
    first: Count = Field(description="Scenes at the top of which `precision` is the share.")
    precision: WithAndWithout
    brier: WithAndWithout = Field(description="Mean square error of the chance; less is better.")
    reliability: tuple[Reliability, ...] = Field(
        max_length=_BINS, description="Calibration of the learned chance, by bins of 0.2."
    )


def folds_of(logs: Sequence[str]) -> Iterator[NDArray[np.bool_]]:
    """Yield (N,) masks of the scenes of one group of logs; logs are dealt in their order."""
    place = {log: number % FOLDS for number, log in enumerate(sorted(set(logs)))}
    fold = np.array([place[log] for log in logs], np.int64)
    for number in np.unique(fold):
        yield fold == number


def effect_of(
    is_right: Column, score: Column, learned: Column, logs: Sequence[str]
) -> LearnedEffect:
    """Compare predicted chances with verdicts.

    Args:
        is_right: 1 where the supervised stream is wrong.
        score: Chance by the score.
        learned: Chance by the verdicts on other logs.
        logs: Log of each scene.
    """
    first = min(_FIRST, max(1, len(is_right) // 3))
    names, number = np.unique(np.array(logs), return_inverse=True)
    members = [np.flatnonzero(number == each) for each in range(len(names))]
    rng, differences = np.random.default_rng(_SEED), []
    for _ in range(_DRAWS):
        drawn = np.concatenate(
            [members[each] for each in rng.integers(len(names), size=len(names))]
        )
        before = _figures(is_right[drawn], score[drawn], first)
        differences.append(_figures(is_right[drawn], learned[drawn], first) - before)
    low, high = _bounds(np.array(differences))
    before, after = (_figures(is_right, each, first) for each in (score, learned))
    both = [
        WithAndWithout(
            score=_known(before[each]),
            learned=_known(after[each]),
            low=_known(low[each]),
            high=_known(high[each]),
        )
        for each in range(3)
    ]
    return LearnedEffect(
        verdicts=len(is_right),
        right=int(is_right.sum()),
        logs=len(names),
        is_used=bool(low[0] > 0),
        average_precision=both[0],
        first=first,
        precision=both[1],
        brier=both[2],
        reliability=tuple(_reliability(is_right, learned)),
    )


def average_precision(is_right: Column, chance: Column) -> float:
    """Return the mean precision at each scene that is right, best chance first; NaN without one.

    Scenes of equal chance count as the mean of their orders would: each at the end of its tie.
    """
    order = np.argsort(-chance, kind="stable")
    right, ordered = is_right[order], chance[order]
    if not right.any():
        return float("nan")
    last_of_tie = np.searchsorted(-ordered, -ordered, side="right")
    found = np.concatenate([[0.0], np.cumsum(right)])[last_of_tie]
    return float((found / last_of_tie)[right > 0].mean())


def _figures(is_right: Column, chance: Column, first: int) -> Column:
    """Return average precision, precision of the first, and Brier score."""
    best = np.argsort(-chance, kind="stable")[:first]
    return np.array(
        [
            average_precision(is_right, chance),
            float(is_right[best].mean()),
            float(((chance - is_right) ** 2).mean()),
        ]
    )


def _bounds(draws: NDArray[np.float64]) -> tuple[Column, Column]:
    """Return the bounds of 95 % of each column; NaN where every draw is undefined."""
    defined = draws[~np.isnan(draws).any(axis=1)]
    if not len(defined):
        nothing = np.full(draws.shape[1], np.nan)
        return nothing, nothing
    low, high = np.percentile(defined, (2.5, 97.5), axis=0)
    return low, high


def _reliability(is_right: Column, chance: Column) -> Iterator[Reliability]:
    bin_of = np.minimum((chance * _BINS).astype(np.int64), _BINS - 1)
    for each in np.unique(bin_of):
        inside = bin_of == each
        yield Reliability(
            scenes=int(inside.sum()),
            predicted=float(chance[inside].mean()),
            right=float(is_right[inside].mean()),
        )


def _known(value: float) -> float | None:
    return None if np.isnan(value) else float(value)
