"""Every selection strategy: one row each. A new one is a file in this folder and a row."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Final, Protocol

from service.curation.ranking import RankedScene
from service.curation.strategies.best_distinct import best_distinct
from service.curation.strategies.chosen import chosen
from service.errors import UsageError


class Choose(Protocol):
    """Chooses scenes under a budget."""

    def __call__(self, ranking: Iterable[RankedScene], *, budget: int) -> list[RankedScene]:
        """Choose at most `budget` scenes of a ranking, which comes best first."""
        ...


@dataclass(frozen=True, slots=True)
class Strategy:
    """One selection strategy.

    Attributes:
        name: Names it.
        choose: The strategy.
        text: What it does, in a sentence.
    """

    name: str
    choose: Choose
    text: str


STRATEGIES: Final = (
    Strategy(
        "best-distinct",
        best_distinct,
        "The best scenes with a reason; twins only where they fill the budget.",
    ),
)

DEFAULT: Final = "best-distinct"

CHOSEN: Final = "chosen"
"""Name in a selection of scenes that a person chose, in place of a strategy."""

Wanted = Collection[str] | None
"""Ids of the scenes that a person chose; None: a strategy chooses."""


def select(
    ranking: Iterable[RankedScene],
    *,
    budget: int,
    strategy: str = DEFAULT,
    wanted: Wanted = None,
) -> list[RankedScene]:
    """Choose scenes for the labellers.

    Args:
        ranking: Best first; read only as far as the strategy needs.
        budget: Scenes the labellers can take, at least 1.
        strategy: Name of a row of `STRATEGIES`.
        wanted: Scenes that a person chose; the strategy is then not used.

    Returns:
        At most `budget` scenes, best first.

    Raises:
        UsageError: If there is no such strategy.
        ValueError: If the budget is below 1.
    """
    if budget < 1:
        raise ValueError(f"budget must be at least 1 scene, got {budget}")
    if wanted is not None:
        return chosen(ranking, budget=budget, wanted=wanted)
    rows = {row.name: row for row in STRATEGIES}
    if strategy not in rows:
        raise UsageError(f"no selection strategy {strategy!r}; known: {', '.join(sorted(rows))}")
    return rows[strategy].choose(ranking, budget=budget)


def strategy_of(wanted: Wanted) -> str:
    """Return the name with which a selection is stored."""
    return DEFAULT if wanted is None else CHOSEN
