"""Every selection strategy: one row each. A new one is a file in this folder and a row."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Protocol

from service.curation.ranking import RankedScene
from service.curation.strategies.best_distinct import best_distinct
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


def select(
    ranking: Iterable[RankedScene], *, budget: int, strategy: str = DEFAULT
) -> list[RankedScene]:
    """Choose scenes for the labellers.

    Args:
        ranking: Best first; read only as far as the strategy needs.
        budget: Scenes the labellers can take, at least 1.
        strategy: Name of a row of `STRATEGIES`.

    Returns:
        At most `budget` scenes, best first.

    Raises:
        UsageError: If there is no such strategy.
        ValueError: If the budget is below 1.
    """
    if budget < 1:
        raise ValueError(f"budget must be at least 1 scene, got {budget}")
    rows = {row.name: row for row in STRATEGIES}
    if strategy not in rows:
        raise UsageError(f"no selection strategy {strategy!r}; known: {', '.join(sorted(rows))}")
    return rows[strategy].choose(ranking, budget=budget)
