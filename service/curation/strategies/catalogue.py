"""Every selection strategy: one row each. A new one is a file in this folder and a row."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from service.curation.candidates import Candidate, Choice
from service.curation.strategies.best_distinct import best_distinct
from service.curation.strategies.chosen import chosen
from service.curation.strategies.determinantal import determinantal
from service.curation.strategies.k_centre import k_centre
from service.curation.strategies.one_pass import one_pass
from service.errors import UsageError


class Choose(Protocol):
    """Chooses scenes under a budget."""

    def __call__(
        self, candidates: Iterable[Candidate], *, budget: int, taken: Sequence[Candidate]
    ) -> list[Choice]:
        """Choose at most `budget` candidates, which come best first, next to those taken."""
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
    Strategy(
        "determinantal",
        determinantal,
        "Scores and unlikeness of all chosen scenes together, balanced over vehicles, software "
        "versions and kinds.",
    ),
    Strategy(
        "k-centre",
        k_centre,
        "Score times distance to the nearest chosen scene, balanced in the same way.",
    ),
    Strategy(
        "one-pass",
        one_pass,
        "As determinantal, in one reading of the ranking with bounded memory.",
    ),
)

DEFAULT: Final = "best-distinct"

CHOSEN: Final = "chosen"
"""Name in a selection of scenes that a person chose, in place of a strategy."""

Wanted = Collection[str] | None
"""Ids of the scenes that a person chose; None: a strategy chooses."""


def select(
    candidates: Iterable[Candidate],
    *,
    budget: int,
    strategy: str = DEFAULT,
    wanted: Wanted = None,
    taken: Sequence[Candidate] = (),
) -> list[Choice]:
    """Choose scenes for the labellers.

    Args:
        candidates: Best first; read only as far as the strategy needs.
        budget: Scenes the labellers can take, at least 1.
        strategy: Name of a row of `STRATEGIES`.
        wanted: Scenes that a person chose; the strategy is then not used.
        taken: Scenes of earlier selections, oldest first. They are no candidates.

    Returns:
        At most `budget` choices in the order of choice.

    Raises:
        UsageError: If there is no such strategy.
        ValueError: If the budget is below 1.
    """
    if budget < 1:
        raise ValueError(f"budget must be at least 1 scene, got {budget}")
    if wanted is not None:
        return chosen(candidates, budget=budget, wanted=wanted)
    return strategy_named(strategy).choose(candidates, budget=budget, taken=taken)


def strategy_named(name: str) -> Strategy:
    """Return the strategy of this name.

    Raises:
        UsageError: If there is none.
    """
    rows = {row.name: row for row in STRATEGIES}
    if name not in rows:
        raise UsageError(f"no selection strategy {name!r}; known: {', '.join(sorted(rows))}")
    return rows[name]


def strategy_of(wanted: Wanted, strategy: str = DEFAULT) -> str:
    """Return the name with which a selection is stored."""
    return strategy if wanted is None else CHOSEN
