"""One pass: the determinantal choice in one reading of the ranking, with bounded memory."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

from service.curation.candidates import Candidate, Choice, rows_of
from service.curation.explanations import whys
from service.curation.objectives import DETERMINANTAL
from service.curation.one_pass import BLOCK, OnePass
from service.curation.strategies.best_distinct import with_reason


def one_pass(
    candidates: Iterable[Candidate],
    *,
    budget: int,
    taken: Sequence[Candidate],
) -> list[Choice]:
    """Choose as `determinantal` does, from all scenes, of which few are in memory at a time.

    Scenes of earlier selections are not compared, and twins are never chosen.
    """
    stream = OnePass[Candidate](DETERMINANTAL, budget=budget)
    distinct = (each for each in with_reason(candidates) if each.scene.twin_of is None)
    for block in _blocks(distinct):
        stream.offer(block, rows_of(block))
    found = stream.chosen()
    chosen = [candidate for candidate, _ in found]
    return [
        Choice(scene=candidate.scene, gain=round(gain, 6), why=why)
        for (candidate, gain), why in zip(found, whys(chosen, before=()), strict=True)
    ]


def _blocks(candidates: Iterator[Candidate]) -> Iterator[list[Candidate]]:
    while block := list(islice(candidates, BLOCK)):
        yield block
