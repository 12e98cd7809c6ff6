"""A stored choice of scenes, and what it left out; `strategies` make the choice. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import MAX_INTEGER, MAX_LISTED, Count, Finite, Kept, Said
from service.curation.listing import ScenesRequest
from service.curation.ranking import RankedScene, has_reason
from service.curation.strategies.catalogue import DEFAULT


class Selection(BaseModel):
    """A named choice of scenes; it never changes once it is stored."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Kept = Field(min_length=1)
    strategy: Kept = Field(
        default="", description="Strategy that chose them; empty: stored by an earlier version."
    )
    budget: int = Field(ge=1, le=MAX_INTEGER, description="Number of scenes requested.")
    scenes: tuple[RankedScene, ...] = Field(
        fail_fast=True,
        max_length=MAX_LISTED,
        description="Best first, with their rank at the time.",
    )

    @property
    def last_rank(self) -> int | None:
        """Lowest rank that was considered; None: all, since the budget was not used up."""
        if len(self.scenes) < self.budget:
            return None
        return max(scene.rank for scene in self.scenes)


class SelectionTerms(BaseModel):
    """Terms by which a selection is chosen."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    strategy: Said = Field(default=DEFAULT, description="Name of a selection strategy.")
    again: bool = Field(
        default=False,
        description="Choose as if no earlier selection had taken any scene.",
    )
    filters: ScenesRequest | None = Field(
        default=None,
        description="Only scenes that pass them; order, cursor and number of rows are not used.",
    )


USUAL_TERMS: Final = SelectionTerms()
"""The default strategy, over every scene that no earlier selection contains."""


class SelectionSummary(BaseModel):
    """A stored selection in a list, without its scenes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Kept = Field(min_length=1)
    strategy: Kept = Field(default="", description="As in the selection.")
    budget: int = Field(ge=1, le=MAX_INTEGER, description="Number of scenes requested.")
    scenes: Count = Field(description="Number of scenes chosen.")
    created_s: Finite = Field(description="When it was stored, seconds since the Unix epoch.")


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Scenes that a selection left out, by cause, best first.

    Attributes:
        twins: Scenes that show what a better scene shows, ranked before the last one selected.
        others: Further scenes with a reason, ranked before it: of earlier selections, excluded by a
            filter, or like scenes that were chosen.
        without: Scenes without a reason, ranked before the last one selected, or anywhere if the
            budget was not used up.
    """

    twins: tuple[RankedScene, ...]
    others: tuple[RankedScene, ...]
    without: tuple[RankedScene, ...]


def left_out(ranking: Sequence[RankedScene], selection: Selection) -> LeftOut:
    """Sort the scenes that a selection left out by their cause.

    Args:
        ranking: Best first, at least as far as the selection considered it.
        selection: Made from this ranking.
    """
    chosen = {scene.scene_id for scene in selection.scenes}
    passed = [row for row in ranking[: selection.last_rank] if row.scene_id not in chosen]
    return LeftOut(
        twins=tuple(row for row in passed if has_reason(row) and row.twin_of is not None),
        others=tuple(row for row in passed if has_reason(row) and row.twin_of is None),
        without=tuple(row for row in passed if not has_reason(row)),
    )


def why_no_reason(scene: RankedScene) -> str:
    """Return in a few words why a scene has no reason to be reviewed."""
    if scene.score <= 0:
        return "nothing contradicts, or it was not judged"
    if not scene.tracks:
        return "no track is strong enough for a reason"
    return "no strong track on which the supervised stream errs"
