"""The best scenes of the ranking, without twins."""

from collections.abc import Iterable
from itertools import islice, takewhile

from service.curation.ranking import RankedScene


def best_distinct(ranking: Iterable[RankedScene], *, budget: int) -> list[RankedScene]:
    """Choose the best distinct scenes.

    Twins are left out, because a labeller who sees the better neighbour sees the same street; so
    are scenes without any contradiction, even when the budget is not used up.

    Args:
        ranking: Best first; read only as far as needed.
        budget: Scenes the labellers can take, at least 1.

    Returns:
        At most `budget` scenes, best first.
    """
    contradicting = takewhile(lambda scene: scene.score > 0, ranking)
    return list(islice((scene for scene in contradicting if scene.twin_of is None), budget))
