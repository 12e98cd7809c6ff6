"""Choice by an objective that joins score, likeness and balance; twins fill the budget. Pure."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import numpy as np

from service.curation.candidates import Candidate, Choice, rows_of
from service.curation.explanations import why_twin, whys
from service.curation.greedy import ReadPool, pick
from service.curation.objectives import ObjectiveKind
from service.curation.strategies.best_distinct import with_reason

MOST_REMEMBERED: Final = 200
"""Scenes of earlier selections, the latest, that count as chosen when likeness is compared."""


def cover(
    candidates: Iterable[Candidate],
    *,
    budget: int,
    taken: Sequence[Candidate],
    objective: ObjectiveKind,
) -> list[Choice]:
    """Choose scenes with a reason by an objective, and then twins until the budget is filled.

    Args:
        candidates: Best first; read only as far as a candidate can change the choice.
        budget: Scenes the labellers can take, at least 1.
        taken: Scenes of earlier selections, oldest first, which count as chosen.
        objective: What a scene adds.

    Returns:
        At most `budget` choices in the order of choice.
    """
    twins: list[Candidate] = []
    pool = ReadPool(_distinct(candidates, twins))
    before = list(taken[-MOST_REMEMBERED:])
    picked = pick(pool, objective, budget=budget, taken=rows_of(before))
    chosen = [pool.read[number] for number in picked.numbers.tolist()]
    choices = [
        Choice(scene=each.scene, gain=gain, why=why)
        for each, gain, why in zip(
            chosen,
            np.round(picked.gains, 6).tolist(),
            whys(chosen, before=before),
            strict=True,
        )
    ]
    return choices + [
        Choice(scene=each.scene, gain=0.0, why=why_twin(each))
        for each in twins[: budget - len(choices)]
    ]


def _distinct(candidates: Iterable[Candidate], twins: list[Candidate]) -> Iterator[Candidate]:
    """Return the candidates that are no twins; note the twins."""
    for each in with_reason(candidates):
        if each.scene.twin_of is None:
            yield each
        else:
            twins.append(each)
