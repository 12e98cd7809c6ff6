"""Selection in one pass over a stream, in any order and with bounded memory. Pure.

The stream is cut into blocks. Of each block and of what is kept so far, the greedy choice of twice
the budget is kept; the selection is the greedy choice of what is kept in the end. This is the
composition of core-sets that has a bound for a stream in random order (Mirrokni and Zadimoghaddam
2015); `bench selection` measures it in three orders.
"""

from typing import Final, Generic, TypeVar

import numpy as np

from service.curation.candidates import Rows
from service.curation.greedy import pick_from
from service.curation.objectives import ObjectiveKind

BLOCK: Final = 4096
"""Scenes in memory in addition to those kept."""

KEPT: Final = 2
"""Scenes that are kept, in budgets."""

Item = TypeVar("Item")


class OnePass(Generic[Item]):
    """Selects from scenes that come one block at a time."""

    def __init__(self, objective: ObjectiveKind, *, budget: int) -> None:
        """Begin with nothing kept."""
        self._objective, self._budget = objective, budget
        self._rows: Rows | None = None
        self._items: list[Item] = []
        self._least = 0.0
        """Gain of the last of the kept scenes; a scene whose score allows less is dropped."""

    def offer(self, items: list[Item], rows: Rows) -> None:
        """Take the next scenes of the stream, any number of them.

        Args:
            items: What the selection returns of each.
            rows: The same scenes as columns.
        """
        for begin in range(0, len(items), BLOCK):
            block = rows.at(slice(begin, begin + BLOCK))
            most = [self._objective.most(quality) for quality in block.quality.tolist()]
            useful = np.flatnonzero(np.array(most) > self._least)
            if len(useful) == 0:
                continue
            new = block.at(useful)
            kept = new if self._rows is None else self._rows.then(new)
            known = self._items + [items[begin + number] for number in useful.tolist()]
            numbers, gains = pick_from(kept, self._objective, budget=KEPT * self._budget)
            if len(numbers) == KEPT * self._budget:
                self._least = float(gains[-1])
            self._rows = kept.at(np.sort(numbers))
            self._items = [known[number] for number in np.sort(numbers).tolist()]

    def chosen(self) -> list[tuple[Item, float]]:
        """Return the selection among what came so far, in the order of choice, with the gains."""
        if self._rows is None:
            return []
        numbers, gains = pick_from(self._rows, self._objective, budget=self._budget)
        items = [self._items[number] for number in numbers.tolist()]
        return list(zip(items, gains.tolist(), strict=True))
