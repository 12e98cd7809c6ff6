"""The best scenes with a reason; twins only where they fill the budget."""

from collections.abc import Iterable, Sequence
from itertools import takewhile

from schemas.score import MIN_REPORTED_STRENGTH
from service.curation.candidates import Candidate, Choice
from service.curation.explanations import why_best
from service.curation.ranking import has_reason


def best_distinct(
    candidates: Iterable[Candidate],
    *,
    budget: int,
    taken: Sequence[Candidate],
) -> list[Choice]:
    """Choose the best distinct scenes, and then twins until the budget is filled.

    A twin comes last, because a labeller who sees the better neighbour sees the same thing. A scene
    without a reason is never chosen, even when the budget is not used up.

    Args:
        candidates: Best first; read only as far as needed.
        budget: Scenes the labellers can take, at least 1.
        taken: Scenes of earlier selections.

    Returns:
        At most `budget` choices, best first.
    """
    distinct: list[Candidate] = []
    twins: list[Candidate] = []
    for each in with_reason(candidates):
        (distinct if each.scene.twin_of is None else twins).append(each)
        if len(distinct) == budget:
            break
    chosen = distinct + twins[: budget - len(distinct)]
    chosen.sort(key=lambda each: each.scene.rank)
    return [Choice(scene=each.scene, gain=each.scene.score, why=why_best(each)) for each in chosen]


def with_reason(candidates: Iterable[Candidate]) -> Iterable[Candidate]:
    """Return the candidates with a reason, which are read no further than one can be."""
    # A score is at least the strength of each track: below the level no scene has a reason.
    strong = takewhile(lambda each: each.scene.score >= MIN_REPORTED_STRENGTH, candidates)
    return (each for each in strong if has_reason(each.scene))
