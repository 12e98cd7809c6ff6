"""Common-mode failures: both streams are wrong, so no comparison of the two can show them."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from schemas.contradiction import ContradictionKind
from workers.lab.evaluation.failures.retrieval import budget_size, order_of
from workers.lab.evaluation.failures.rows import SceneRow

BUDGET: Final = 0.10
WITNESS_ALONE: Final = ContradictionKind.ONLY_WITNESS_DYNAMIC.value
"""Kind of a contradicting track on which the third witness contradicts both streams."""


class CommonMode(BaseModel):
    """Counts and recall of the planted common-mode failures."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    planted: int = Field(description="Planted as common-mode, and shown by the labels.")
    both_wrong: int = Field(description="Of them: the other stream is wrong on most points too.")
    surfaced: int = Field(
        description="Of those: the witness contradicts both, and the scene is in the best 10 %."
    )
    witnessed: int = Field(description="Of those: the witness contradicts both, at any rank.")
    in_budget: int = Field(description="Of those: the scene is in the best 10 %, for any reason.")
    recall: float | None = Field(description="Surfaced of both wrong; null: there are none.")


def common_mode(scenes: Sequence[SceneRow]) -> CommonMode:
    """Count common-mode failures, and those that the witness and the ranking surface."""
    scores = np.array([scene.score for scene in scenes])
    best = set(order_of(scores)[: budget_size(BUDGET, len(scenes))].tolist()) if scenes else set()
    planted = both = surfaced = witnessed = within = 0
    for place, scene in enumerate(scenes):
        spoken = {track.thing for track in scene.tracks if track.kind == WITNESS_ALONE}
        for thing in scene.failing:
            planted += thing.common_mode
            if not thing.common_mode or thing.other_wrong_share <= 0.5:
                continue
            both += 1
            witnessed += thing.key in spoken
            within += place in best
            surfaced += thing.key in spoken and place in best
    return CommonMode(
        planted=planted,
        both_wrong=both,
        surfaced=surfaced,
        witnessed=witnessed,
        in_budget=within,
        recall=round(surfaced / both, 4) if both else None,
    )
