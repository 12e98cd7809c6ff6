"""Ranking figures per kind of failure."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from workers.lab.evaluation.failures.retrieval import (
    BUDGETS,
    budget_name,
    budget_size,
    order_of,
    retrieve,
)
from workers.lab.evaluation.failures.rows import SceneRow


class KindRow(BaseModel):
    """Ranking figures of one kind, among scenes that fail in this way or not at all."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scenes: int = Field(description="Scenes that contain a failure of the kind.")
    ap: float | None = Field(description="Average precision against scenes without failure.")
    recall_at: dict[str, float] = Field(
        description="By budget of all scenes: share of the kind's scenes inside the budget."
    )
    median_rank_share: float = Field(description="0: at the top of all scenes; 1: at the bottom.")


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
        rows[kind] = KindRow(
            scenes=int(mine.sum()),
            ap=retrieve(scores[asked], mine[asked], ()).ap,
            recall_at={
                budget_name(budget): round(
                    float((rank[mine] < budget_size(budget, len(rank))).mean()), 4
                )
                for budget in BUDGETS
            },
            median_rank_share=round(float(np.median(rank[mine])) / max(1, len(rank) - 1), 4),
        )
    return rows
