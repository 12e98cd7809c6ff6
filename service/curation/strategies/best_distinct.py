"""The best scenes with a reason; twins only where they fill the budget."""

from collections.abc import Iterable
from itertools import takewhile

from schemas.score import MIN_REPORTED_STRENGTH
from service.curation.ranking import RankedScene, has_reason


def best_distinct(ranking: Iterable[RankedScene], *, budget: int) -> list[RankedScene]:
    """Choose the best distinct scenes, and then twins until the budget is filled.

    A twin comes last, because a labeller who sees the better neighbour sees the same thing. A scene
    without a reason is never chosen, even when the budget is not used up.

    Args:
        ranking: Best first; read only as far as needed.
        budget: Scenes the labellers can take, at least 1.

    Returns:
        At most `budget` scenes, best first.
    """
    distinct: list[RankedScene] = []
    twins: list[RankedScene] = []
    # A score is at least the strength of each track: below the level no scene has a reason.
    for scene in takewhile(lambda scene: scene.score >= MIN_REPORTED_STRENGTH, ranking):
        if has_reason(scene):
            (distinct if scene.twin_of is None else twins).append(scene)
        if len(distinct) == budget:
            break
    chosen = distinct + twins[: budget - len(distinct)]
    return sorted(chosen, key=lambda scene: scene.rank)
