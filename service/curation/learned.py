"""A ranking that learns from verdicts: a correction of the score, and its effect. Pure.

The chance that the supervised stream is wrong on a scene is a logistic model. The log-odds of the
score are a fixed offset, and the descriptor of the scene corrects them. The correction is
regularised (L2), so that it shrinks to the score where verdicts are few. Source: ridge logistic
regression, Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, section 4.4.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.events import RankedScene
from schemas.verdict import DECIDED, RIGHT, VerdictRow
from service.curation.descriptors import describe, describing
from service.curation.learned_effect import LearnedEffect, effect_of, folds_of
from service.errors import UsageError

MIN_VERDICTS: Final = 30
"""Judged scenes below which nothing is learned: their effect could not be measured."""

_PENALTY: Final = 2.0
"""Inverse variance of each weight before the verdicts. A descriptor has length one: the correction
has a standard deviation of 0.7 in log-odds. A quarter of this was worse on simulated fleets.
"""

_LEAST_ODDS: Final = 0.01
"""Scores are clipped to this and one minus this, so that their log-odds are finite."""

_STEPS: Final = 50
"""Newton steps at most; about six suffice."""

_CONVERGED: Final = 1e-9
"""Largest change of a weight at which the steps end."""

Column = NDArray[np.float64]
"""(N,) one number per scene."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Scenes with a verdict that decides, as columns of one length N.

    Attributes:
        number: Number of each in the ranking, from 0.
        is_right: 1 where the supervised stream is wrong by the majority of reviewers, else 0.
        log: Log of each.
    """

    number: NDArray[np.int64]
    is_right: Column
    log: tuple[str, ...]


def learned_ranking(
    scenes: Sequence[RankedScene], verdicts: Iterable[VerdictRow]
) -> tuple[list[RankedScene], list[float], LearnedEffect]:
    """Rank scenes by what verdicts teach, where this ranks unseen verdicts better.

    Args:
        scenes: Every current scene, by the score.
        verdicts: Verdicts that count.

    Returns:
        The scenes with their new ranks, the chance that the supervised stream is wrong on each,
        and the effect. Without a gain the order is that of the score, and so are the chances.

    Raises:
        UsageError: If fewer than `MIN_VERDICTS` scenes are judged, or these are of a single log.
    """
    judged = judged_of(scenes, verdicts)
    if len(judged.number) < MIN_VERDICTS:
        raise UsageError(
            f"{len(judged.number)} scenes have a verdict that decides, and {MIN_VERDICTS} are "
            "needed to learn from: judge more, or rank without --learned"
        )
    if len(set(judged.log)) < 2:
        raise UsageError(
            f"all {len(judged.number)} verdicts are on one log, so that their effect cannot be "
            "tested on another: judge scenes of a second one, or rank without --learned"
        )
    features, offset = features_of(scenes), offset_of(scenes)
    seen, known = judged.number, judged.is_right
    unseen = np.empty(len(seen))
    for fold in folds_of(judged.log):
        weights = fit(features[seen[~fold]], offset[seen[~fold]], known[~fold])
        unseen[fold] = chance_of(features[seen[fold]], offset[seen[fold]], weights)
    effect = effect_of(known, chance_of_odds(offset[seen]), unseen, judged.log)
    chances = chance_of_odds(offset)
    if not effect.is_used:
        return list(scenes), chances.tolist(), effect
    chances = chance_of(features, offset, fit(features[seen], offset[seen], known))
    order = np.argsort(-chances, kind="stable").tolist()
    ranked = [
        scenes[number].model_copy(update={"rank": rank}) for rank, number in enumerate(order, 1)
    ]
    return ranked, chances[order].tolist(), effect


def judged_of(scenes: Sequence[RankedScene], verdicts: Iterable[VerdictRow]) -> Judged:
    """Return the scenes that are decided by the majority of their reviewers.

    Only verdicts on the current record count. A reviewer finds the supervised stream wrong by any
    verdict on the scene or a track. A scene on which reviewers are tied is left out.
    """
    number_of = {(each.scene_id, each.sha256): number for number, each in enumerate(scenes)}
    opinions: defaultdict[int, dict[str, bool]] = defaultdict(dict)
    for row in verdicts:
        number = number_of.get((row.scene_id, row.sha256))
        if number is not None and row.verdict in DECIDED:
            theirs = opinions[number]
            theirs[row.reviewer] = theirs.get(row.reviewer, False) or row.verdict in RIGHT
    votes = {number: (sum(each.values()), len(each)) for number, each in opinions.items()}
    decided = {number: 2 * yes > of for number, (yes, of) in votes.items() if 2 * yes != of}
    numbers = sorted(decided)
    return Judged(
        number=np.array(numbers, np.int64),
        is_right=np.array([decided[number] for number in numbers], np.float64),
        log=tuple(scenes[number].log_id for number in numbers),
    )


def features_of(scenes: Sequence[RankedScene]) -> NDArray[np.float64]:
    """Return (N, D) features: the descriptor, the attributed chance and the number of tracks.

    The attributed chance is that of the strongest listed track; the descriptor has its attribution.
    """
    strongest = [describing(scene)[:1] for scene in scenes]
    chance = [each[0].chance or 0.0 if each else 0.0 for each in strongest]
    number = [len(describing(scene)) / 5.0 for scene in scenes]
    rest = np.array([np.ones(len(scenes)), chance, number], np.float64).T
    return np.hstack([describe(scenes).astype(np.float64), rest])


def offset_of(scenes: Sequence[RankedScene]) -> Column:
    """Return the log-odds of the scores."""
    score = np.clip([scene.score for scene in scenes], _LEAST_ODDS, 1 - _LEAST_ODDS)
    odds: Column = np.log(score / (1 - score))
    return odds


def fit(features: NDArray[np.float64], offset: Column, is_right: Column) -> Column:
    """Fit the weights of the correction, (D,), by Newton's method.

    The penalised likelihood is strictly concave, so that the solution is unique.

    Args:
        features: (N, D) features of the judged scenes.
        offset: (N,) log-odds of their scores.
        is_right: (N,) 1 where the supervised stream is wrong.
    """
    weights = np.zeros(features.shape[1])
    for _ in range(_STEPS):
        chance = chance_of(features, offset, weights)
        curvature = features.T @ (features * (chance * (1 - chance))[:, None])
        gradient = features.T @ (is_right - chance) - _PENALTY * weights
        change = np.linalg.solve(curvature + _PENALTY * np.eye(len(weights)), gradient)
        before = _loss(features, offset, is_right, weights)
        while _loss(features, offset, is_right, weights + change) > before + _CONVERGED:
            change = change / 2
        weights = weights + change
        if np.abs(change).max() < _CONVERGED:
            break
    return weights


def _loss(
    features: NDArray[np.float64], offset: Column, is_right: Column, weights: Column
) -> float:
    """Return the penalised loss, which a full step can increase where chances are near 0 or 1."""
    odds = offset + features @ weights
    loss = np.sum(np.logaddexp(0.0, odds) - is_right * odds) + _PENALTY * weights @ weights / 2
    return float(loss)


def chance_of(features: NDArray[np.float64], offset: Column, weights: Column) -> Column:
    """Return the chance that the supervised stream is wrong on each scene."""
    return chance_of_odds(offset + features @ weights)


def chance_of_odds(log_odds: Column) -> Column:
    """Return chances, 0 to 1, from log-odds."""
    chance: Column = 1 / (1 + np.exp(-np.clip(log_odds, -30.0, 30.0)))
    return chance
