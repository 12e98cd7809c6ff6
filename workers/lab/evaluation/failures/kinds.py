"""Ranking figures per kind of failure."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from workers.lab.evaluation.failures.attribution import is_evaluated
from workers.lab.evaluation.failures.retrieval import (
    BUDGETS,
    budget_name,
    budget_size,
    order_of,
    retrieve,
)
from workers.lab.evaluation.failures.rows import SceneRow, TrackRow


class KindRow(BaseModel):
    """Ranking figures of one kind, among scenes that fail in this way or not at all."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scenes: int = Field(description="Scenes that contain a failure of the kind.")
    ap: float | None = Field(description="Average precision against scenes without failure.")
    recall_at: dict[str, float] = Field(
        description="By budget of all scenes: share of the kind's scenes inside the budget."
    )
    recall_at_base: float = Field(
        default=0.0, description="Share of the kind's scenes among as many scenes as fail."
    )
    tracks: int = Field(
        default=0, description="Contradicting tracks on its failing objects, with a true verdict."
    )
    attributed: int = Field(default=0, description="Of them, those with the true verdict.")
    median_rank_share: float = Field(description="0: at the top of all scenes; 1: at the bottom.")


def tracks_on(scene: SceneRow, kind: str) -> list[TrackRow]:
    """Return the contradicting tracks on the failing objects of a kind."""
    keys = {thing.key for thing in scene.failing if thing.kind == kind}
    return [each for each in scene.tracks if each.thing in keys]


def _is_right(track: TrackRow) -> bool:
    return track.said is not None and track.said.wrong is track.verdict


def figures_by_kind(scenes: Sequence[SceneRow], scores: NDArray[np.float64]) -> dict[str, KindRow]:
    """Compute the ranking figures of each kind."""
    order = order_of(scores)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    fails = np.array([scene.fails for scene in scenes], dtype=np.bool_)
    rows = {}
    for kind in sorted({thing.kind for scene in scenes for thing in scene.failing}):
        mine = np.array([any(t.kind == kind for t in scene.failing) for scene in scenes])
        asked = mine | ~fails
        judged = [each for scene in scenes for each in tracks_on(scene, kind) if is_evaluated(each)]
        rows[kind] = KindRow(
            scenes=int(mine.sum()),
            ap=retrieve(scores[asked], mine[asked], ()).ap,
            recall_at={
                budget_name(budget): round(
                    float((rank[mine] < budget_size(budget, len(rank))).mean()), 4
                )
                for budget in BUDGETS
            },
            recall_at_base=round(float((rank[mine] < fails.sum()).mean()), 4),
            tracks=len(judged),
            attributed=sum(_is_right(each) for each in judged),
            median_rank_share=round(float(np.median(rank[mine])) / max(1, len(rank) - 1), 4),
        )
    return rows
