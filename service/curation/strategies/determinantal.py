"""Determinantal: greedy maximum of the log-determinant of scores times likeness."""

from collections.abc import Iterable, Sequence

from service.curation.candidates import Candidate, Choice
from service.curation.objectives import DETERMINANTAL
from service.curation.strategies.covering import cover


def determinantal(
    candidates: Iterable[Candidate], *, budget: int, taken: Sequence[Candidate]
) -> list[Choice]:
    """Choose scenes of high scores that differ as a whole, from each other and from those taken."""
    return cover(candidates, budget=budget, taken=taken, objective=DETERMINANTAL)
