"""A stored choice of scenes, and what it passed over; `strategies` make the choice. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import MAX_INTEGER, MAX_LISTED, Kept
from service.curation.ranking import RankedScene


class Selection(BaseModel):
    """A named choice of scenes; it never changes once it is stored."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Kept = Field(min_length=1)
    budget: int = Field(ge=1, le=MAX_INTEGER, description="Number of scenes requested.")
    scenes: tuple[RankedScene, ...] = Field(
        max_length=MAX_LISTED, description="Best first, with their rank at the time."
    )

    @property
    def last_rank(self) -> int | None:
        """Lowest rank that was considered; None: all, since the budget was not used up."""
        return self.scenes[-1].rank if len(self.scenes) == self.budget else None


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Numbers of scenes that a selection left out, by cause.

    Attributes:
        twins: Scenes next to a better one of their log, ranked before the last one selected, or
            anywhere if the budget was not used up.
        without: Scenes without a contradiction; counted if the budget was not used up.
    """

    twins: int
    without: int


def left_out(ranking: Sequence[RankedScene], selection: Selection) -> LeftOut:
    """Count the scenes that a selection left out.

    Args:
        ranking: Best first, at least as far as the selection considered it.
        selection: Made from this ranking.
    """
    passed = ranking[: selection.last_rank]
    without = sum(scene.score <= 0 for scene in passed)
    twins = sum(scene.twin_of is not None and scene.score > 0 for scene in passed)
    return LeftOut(twins, without)
