"""Who is wrong about a track: chances that follow from named evidence by one published table.

    odds of each answer = intercept + sum of weight x evidence;   chance = exp(odds) / sum of exp

One multinomial logistic regression for each kind of contradiction, over the numbers of
`track_features.py`, all between 0 and 1, so that a weight says what its evidence is worth. Fitted
by `python -m workers.lab.training.attribution` on logs with truth and written to
`attribution.json`, with a card that says on what, and how well. An answer without a row has no
chance.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Final

from schemas.attribution import MOST_WORDS, Attribution, Wrong
from workers.contradiction.explanations import AS_MOST, LIKELIEST, Remark
from workers.contradiction.track_features import NAMES, Evidence

FILE: Final = "attribution.json"
_DIGITS: Final = 3
_MOST_ODDS: Final = 30.0

_SUPERVISED: Final = frozenset({Wrong.SUPERVISED, Wrong.BOTH})
"""Answers by which the supervised stream is wrong."""

NOTHING: Final = 0.1
"""Log-odds: what moves a chance of a half by less than 0.025 speaks neither for nor against."""


@dataclass(frozen=True, slots=True)
class Odds:
    """Log-odds of one answer.

    Attributes:
        intercept: Where all evidence is 0.
        weights: What each named number adds at 1; those left out add nothing.
    """

    intercept: float
    weights: Mapping[str, float]

    def of(self, evidence: Mapping[str, float]) -> float:
        """Log-odds that follow from evidence, against those of the other answers."""
        odds = self.intercept + sum(
            weight * evidence[name] for name, weight in self.weights.items()
        )
        return max(-_MOST_ODDS, min(_MOST_ODDS, odds))


Table = Mapping[Wrong, Odds]
"""The odds of each answer that a kind of contradiction allows."""


def table_of(rows: Mapping[str, Any]) -> Table:
    """Read the rows of one kind.

    Raises:
        ValueError: If they rest on evidence that does not exist.
    """
    table = {}
    for wrong, row in rows.items():
        if unknown := sorted(set(row["weights"]) - set(NAMES)):
            raise ValueError(f"{FILE} rests on evidence that there is not: {', '.join(unknown)}")
        table[Wrong(wrong)] = Odds(float(row["intercept"]), dict(row["weights"]))
    return table


@cache
def tables() -> Mapping[str, Table]:
    """Read the tables that ship, by the name of the kind of contradiction."""
    text = resources.files("workers.contradiction").joinpath(FILE).read_text(encoding="utf-8")
    return {kind: table_of(rows) for kind, rows in json.loads(text)["kinds"].items()}


def chances(table: Table, evidence: Mapping[str, float]) -> dict[Wrong, float]:
    """Chance of each answer; they add up to 1."""
    odds = {wrong: row.of(evidence) for wrong, row in table.items()}
    highest = max(odds.values())
    shares = {wrong: math.exp(value - highest) for wrong, value in odds.items()}
    total = sum(shares.values())
    return {wrong: shares.get(wrong, 0.0) / total for wrong in Wrong}


def weight_of(
    otherwise: Mapping[str, float], table: Table, evidence: Mapping[str, float], wrong: Wrong
) -> float:
    """What evidence adds to the log-odds that the supervised stream is wrong, or that it is not.

    Which of the two is what the answer says of it: that decides what a look is worth. It is the
    difference to the same track with that evidence as it would be otherwise.
    """
    there = _log_odds(table, evidence)
    added = there - _log_odds(table, {**evidence, **otherwise})
    return added if wrong in _SUPERVISED else -added


def attribute(kind: str, evidence: Evidence, *, remarks: Sequence[Remark] = ()) -> Attribution:
    """Say who is wrong about a track.

    Args:
        kind: Name of the kind of contradiction.
        evidence: What is known about the track.
        remarks: What of it is worth saying; sorted by whether it speaks for the answer.
    """
    table, named = tables()[kind], evidence.named()
    known = chances(table, named)
    rounded = {wrong: round(chance, _DIGITS) for wrong, chance in known.items()}
    answer = max(Wrong, key=lambda wrong: rounded[wrong])
    weighed = sorted(
        (
            (round(weight_of(remark.otherwise, table, named, answer), _DIGITS), remark)
            for remark in remarks
        ),
        key=lambda each: -abs(each[0]),
    )
    told = [(weight, remark.words) for weight, remark in weighed if not remark.quiet][:MOST_WORDS]
    if weighed and all(weight < NOTHING for weight, _ in told):
        quiet = max((each for each in weighed if each[1].quiet), key=_by_weight, default=None)
        if quiet is not None and quiet[0] >= NOTHING:
            first = (quiet[0], quiet[1].words)
        else:
            first = (NOTHING, _by_kind(kind, table, named, answer, remarks))
        told = [first, *told[: MOST_WORDS - 1]]
    return Attribution(
        wrong=answer,
        supervised=rounded[Wrong.SUPERVISED],
        selfsupervised=rounded[Wrong.SELFSUPERVISED],
        both=rounded[Wrong.BOTH],
        neither=rounded[Wrong.NEITHER],
        because=tuple(words for weight, words in told if weight >= NOTHING),
        against=tuple(words for weight, words in told if weight <= -NOTHING),
        also=tuple(words for weight, words in told if abs(weight) < NOTHING),
    )


def _by_weight(weighed: tuple[float, Remark]) -> float:
    return weighed[0]


def _by_kind(
    kind: str,
    table: Table,
    evidence: Mapping[str, float],
    answer: Wrong,
    remarks: Sequence[Remark],
) -> str:
    """What speaks for an answer for which no remark does.

    It is the kind, where a track of it would be so without all that is remarked; else nothing but
    that the other three are less likely still.
    """
    without = dict(evidence)
    for remark in remarks:
        if not remark.quiet:
            without |= remark.otherwise
    odds = _log_odds(table, without)
    if (odds if answer in _SUPERVISED else -odds) >= NOTHING:
        return AS_MOST[kind]
    return LIKELIEST


def _log_odds(table: Table, evidence: Mapping[str, float]) -> float:
    """Log-odds that the supervised stream is wrong, alone or not."""
    odds = {answer: row.of(evidence) for answer, row in table.items()}
    errs = [value for answer, value in odds.items() if answer in _SUPERVISED]
    rest = [value for answer, value in odds.items() if answer not in _SUPERVISED]
    return _log_sum(errs) - _log_sum(rest)


def _log_sum(odds: Sequence[float]) -> float:
    highest = max(odds)
    return highest + math.log(sum(math.exp(value - highest) for value in odds))
