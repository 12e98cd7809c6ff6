"""Greedy choice under a budget, over as much of the ranking as can change it. Pure."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from service.curation.candidates import Candidate, Rows, rows_of
from service.curation.objectives import ObjectiveKind

FIRST_READ: Final = 512
"""Candidates that are read first; four times as many where others may change the choice."""

MOST_READ: Final = 4096
"""Candidates that are compared at most. Beyond them a candidate is left out, although its score
would let it add more than the last choice does.
"""


class Pool(Protocol):
    """Candidates in the order of their scores, best first."""

    def first(self, count: int) -> Rows:
        """Return the first candidates, all where there are fewer."""
        ...

    def quality_at(self, number: int) -> float:
        """Return the score of the candidate after `number` others; 0 where there is none."""
        ...


class ReadPool:
    """Pool that reads a ranking lazily."""

    def __init__(self, candidates: Iterable[Candidate]) -> None:
        """Begin with nothing read."""
        self._unread: Iterator[Candidate] = iter(candidates)
        self.read: list[Candidate] = []
        self._rows = rows_of(())

    def first(self, count: int) -> Rows:
        """Return the first candidates, all where there are fewer."""
        self._read(count)
        new = self.read[len(self._rows) : count]
        if new:
            self._rows = self._rows.then(rows_of(new))
        return self._rows.at(slice(0, count))

    def quality_at(self, number: int) -> float:
        """Return the score of the candidate after `number` others; 0 where there is none."""
        self._read(number + 1)
        return self.read[number].scene.score if number < len(self.read) else 0.0

    def _read(self, count: int) -> None:
        self.read += islice(self._unread, max(0, count - len(self.read)))


@dataclass(frozen=True, slots=True, eq=False)
class Picked:
    """A greedy choice.

    Attributes:
        numbers: Numbers of the candidates in the order of choice.
        gains: What each added.
        compared: Candidates that were compared.
        missed: Most that a candidate beyond them could have added to one choice in excess of what
            was chosen; 0: the choice is that of all candidates.
    """

    numbers: NDArray[np.int64]
    gains: NDArray[np.float64]
    compared: int
    missed: float


def pick(
    pool: Pool,
    objective: ObjectiveKind,
    *,
    budget: int,
    taken: Rows | None = None,
    most_read: int = MOST_READ,
) -> Picked:
    """Choose greedily from a pool.

    A candidate adds at most what its score allows, and later choices add less than earlier ones.
    No candidate therefore matters whose score allows less than the last choice adds.

    Args:
        pool: Candidates, best first.
        objective: What they add.
        budget: Number to choose, at least 1.
        taken: Scenes of earlier selections, which count as chosen first.
        most_read: Candidates that are compared at most.
    """
    count = max(FIRST_READ, 2 * budget)
    while True:
        rows = pool.first(count)
        numbers, gains = pick_from(rows, objective, budget=budget, taken=taken)
        beyond = pool.quality_at(count)
        excess = objective.most(beyond) - (gains[-1] if len(gains) == budget else 0.0)
        done = beyond <= 0.0 or excess <= 0.0
        if done or count >= most_read:
            missed = 0.0 if done else float(excess)
            return Picked(numbers, gains, compared=len(rows), missed=missed)
        count = min(4 * count, most_read)


def pick_from(
    rows: Rows, objective: ObjectiveKind, *, budget: int, taken: Rows | None = None
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Choose greedily from all of some candidates; return their numbers and what each added."""
    before = 0 if taken is None else len(taken)
    state = objective.begin(rows if taken is None else taken.then(rows))
    for number in range(before):
        state.take(number)
    free = np.ones(before + len(rows), bool)
    free[:before] = False
    numbers: list[int] = []
    added: list[float] = []
    for _ in range(min(budget, len(rows))):
        gains = np.where(free, state.gains(), -np.inf)
        best = int(np.argmax(gains))
        free[best] = False
        state.take(best)
        numbers.append(best - before)
        added.append(float(gains[best]))
    return np.array(numbers, np.int64), np.array(added)


def value_of(rows: Rows, chosen: Sequence[int], objective: ObjectiveKind) -> float:
    """Return the sum of what choices add, in their order: the objective's value."""
    state, total = objective.begin(rows.at(np.array(chosen, np.int64))), 0.0
    for number in range(len(chosen)):
        total += float(state.gains()[number])
        state.take(number)
    return total
