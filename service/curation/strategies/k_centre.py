"""k-centre: the scene of the greatest score times distance to its nearest chosen one is next."""

from collections.abc import Iterable, Sequence

from service.curation.candidates import Candidate, Choice
from service.curation.objectives import K_CENTRE
from service.curation.strategies.covering import cover


def k_centre(
    candidates: Iterable[Candidate], *, budget: int, taken: Sequence[Candidate]
) -> list[Choice]:
    """Choose scenes that are far from each other and from those taken, the best of them first."""
    return cover(candidates, budget=budget, taken=taken, objective=K_CENTRE)
