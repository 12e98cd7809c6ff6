"""Attribute a contradiction to a stream: four probabilities, from one fitted table.

    log-odds of an attribution = intercept + sum of weight x feature
    chance of an attribution   = exp(log-odds) / sum of exp(log-odds)

The table holds one multinomial logistic regression per kind of contradiction, over the features of
`track_features.py`. All features are between 0 and 1, so that weights can be compared. `python -m
workers.lab.training.attribution` fits it on logs with truth and writes `attribution.json`, with a
card of its data and scores. An attribution without a row has no chance.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from operator import mul
from typing import Any, Final

from schemas.attribution import MAX_EVIDENCE, Attribution, Wrong
from workers.contradiction.explanations import (
    MOST_PROBABLE,
    TYPICAL_OF_KIND,
    Explanation,
    explanations_of,
)
from workers.contradiction.track_features import NAMES, DescribedTrack, TrackFeatures

FILE: Final = "attribution.json"
_DIGITS: Final = 3
_MOST_ODDS: Final = 30.0

_SUPERVISED: Final = frozenset({Wrong.SUPERVISED, Wrong.BOTH})
"""Attributions by which the supervised stream is wrong."""

NEGLIGIBLE: Final = 0.1
"""Log-odds below which a feature is neutral: it moves a chance of 0.5 by less than 0.025."""


@dataclass(frozen=True, slots=True)
class Odds:
    """Log-odds of one attribution.

    Attributes:
        intercept: Log-odds where all features are 0.
        weights: Log-odds that each feature adds at 1; those left out add nothing.
    """

    intercept: float
    weights: Mapping[str, float]

    def of(self, features: Mapping[str, float]) -> float:
        """Return the log-odds for given features, against the other attributions."""
        weighed = map(mul, self.weights.values(), map(features.__getitem__, self.weights))
        odds = self.intercept + float(sum(weighed))
        return max(-_MOST_ODDS, min(_MOST_ODDS, odds))


Table = Mapping[Wrong, Odds]
"""Log-odds of each attribution that a kind of contradiction allows."""


def table_of(rows: Mapping[str, Any]) -> Table:
    """Read the rows of one kind.

    Raises:
        ValueError: If they use features that do not exist.
    """
    table = {}
    for wrong, row in rows.items():
        if unknown := sorted(set(row["weights"]) - set(NAMES)):
            raise ValueError(f"{FILE} uses features that do not exist: {', '.join(unknown)}")
        table[Wrong(wrong)] = Odds(float(row["intercept"]), dict(row["weights"]))
    return table


@cache
def tables() -> Mapping[str, Table]:
    """Read the shipped tables, by the name of the kind of contradiction."""
    text = resources.files("workers.contradiction").joinpath(FILE).read_text(encoding="utf-8")
    return {kind: table_of(rows) for kind, rows in json.loads(text)["kinds"].items()}


def chances(table: Table, features: Mapping[str, float]) -> dict[Wrong, float]:
    """Return the chance of each attribution; they add up to 1."""
    odds = {wrong: row.of(features) for wrong, row in table.items()}
    highest = max(odds.values())
    shares = {wrong: math.exp(value - highest) for wrong, value in odds.items()}
    total = sum(shares.values())
    return {wrong: shares.get(wrong, 0.0) / total for wrong in Wrong}


def weight_of(
    counterfactual: Mapping[str, float], table: Table, features: Mapping[str, float], wrong: Wrong
) -> float:
    """Return the log-odds that features add to what an attribution states of the supervised stream.

    It states that this stream is wrong, or that it is not, which decides the strength of the track.
    The weight is the difference to the same track with the counterfactual features.
    """
    return _weight_of(counterfactual, table, features, wrong, _log_odds(table, features))


def _weight_of(
    counterfactual: Mapping[str, float],
    table: Table,
    features: Mapping[str, float],
    wrong: Wrong,
    there: float,
) -> float:
    """Return `weight_of`, given the log-odds of the features themselves."""
    added = there - _log_odds(table, {**features, **counterfactual})
    return added if wrong in _SUPERVISED else -added


def attribute_tracks(
    described: Sequence[DescribedTrack], *, taught: bool = False
) -> tuple[Attribution | None, ...]:
    """Attribute the contradiction of each track to a stream.

    Args:
        described: The tracks of a scene with their features.
        taught: The supervised stream was taught by the self-supervised one. Both then share errors
            that the tables, fitted on independent streams, do not know.

    Returns:
        One attribution per track; None for a kind of contradiction that no table was fitted for,
        and for all where the streams are not independent.
    """
    if taught:
        return (None,) * len(described)
    return tuple(_attribution_of(each) for each in described)


def _attribution_of(described: DescribedTrack) -> Attribution | None:
    kind = described.track.kind
    if kind.name not in tables():
        return None
    explanations = explanations_of(
        kind.name, described.features, described.size_m, of_witness=kind.of_witness
    )
    return attribute(kind.name, described.features, explanations=explanations)


def attribute(
    kind: str, features: TrackFeatures, *, explanations: Sequence[Explanation] = ()
) -> Attribution:
    """Estimate which stream is wrong about a track, and sort the explanations by their weight.

    Args:
        kind: Name of the kind of contradiction.
        features: Features of the track.
        explanations: Explanations that apply to it.
    """
    table, named = tables()[kind], features.named()
    known = chances(table, named)
    rounded = {wrong: round(chance, _DIGITS) for wrong, chance in known.items()}
    answer = max(Wrong, key=lambda wrong: rounded[wrong])
    there = _log_odds(table, named)
    weighed = sorted(
        (
            (round(_weight_of(each.counterfactual, table, named, answer, there), _DIGITS), each)
            for each in explanations
        ),
        key=lambda each: -abs(each[0]),
    )
    kept = [(weight, each.words) for weight, each in weighed if not each.quiet][:MAX_EVIDENCE]
    if weighed and all(weight < NEGLIGIBLE for weight, _ in kept):
        quiet = max((each for each in weighed if each[1].quiet), key=_by_weight, default=None)
        if quiet is not None and quiet[0] >= NEGLIGIBLE:
            first = (quiet[0], quiet[1].words)
        else:
            first = (NEGLIGIBLE, _by_kind(kind, table, named, answer, explanations))
        kept = [first, *kept[: MAX_EVIDENCE - 1]]
    return Attribution(
        wrong=answer,
        supervised=rounded[Wrong.SUPERVISED],
        selfsupervised=rounded[Wrong.SELFSUPERVISED],
        both=rounded[Wrong.BOTH],
        neither=rounded[Wrong.NEITHER],
        supporting=tuple(words for weight, words in kept if weight >= NEGLIGIBLE),
        opposing=tuple(words for weight, words in kept if weight <= -NEGLIGIBLE),
        neutral=tuple(words for weight, words in kept if abs(weight) < NEGLIGIBLE),
    )


def _by_weight(weighed: tuple[float, Explanation]) -> float:
    return weighed[0]


def _by_kind(
    kind: str,
    table: Table,
    features: Mapping[str, float],
    answer: Wrong,
    explanations: Sequence[Explanation],
) -> str:
    """Return the explanation of an attribution that no feature supports.

    It is the kind of contradiction, where a track of that kind without the explained features gets
    the same attribution; otherwise the attribution is only the most probable of the four.
    """
    without = dict(features)
    for each in explanations:
        if not each.quiet:
            without |= each.counterfactual
    odds = _log_odds(table, without)
    if (odds if answer in _SUPERVISED else -odds) >= NEGLIGIBLE:
        return TYPICAL_OF_KIND[kind]
    return MOST_PROBABLE


def _log_odds(table: Table, features: Mapping[str, float]) -> float:
    """Return the log-odds that the supervised stream is wrong, alone or not."""
    odds = {answer: row.of(features) for answer, row in table.items()}
    errs = [value for answer, value in odds.items() if answer in _SUPERVISED]
    rest = [value for answer, value in odds.items() if answer not in _SUPERVISED]
    return _log_sum(errs) - _log_sum(rest)


def _log_sum(odds: Sequence[float]) -> float:
    highest = max(odds)
    return highest + math.log(sum(math.exp(value - highest) for value in odds))
