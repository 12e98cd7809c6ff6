"""False alarms: scores of scenes whose disturbance is no failure of the model."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from workers.lab.evaluation.failures.retrieval import budget_size
from workers.lab.evaluation.failures.rows import SceneRow

BUDGET: Final = 0.05
NOTHING: Final = "none"


class FalseAlarmShare(BaseModel):
    """Scenes without failure that a reviewer with a 5 % budget would be shown."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scenes: int = Field(description="Without failure.")
    above: int = Field(description="Of them, above the score that marks the budget.")
    share: float | None
    threshold: float = Field(description="Score of the budget over undisturbed scenes.")


def budget_threshold(scenes: Sequence[SceneRow]) -> float:
    """Find the score that marks the 5 % budget among undisturbed scenes."""
    scores = np.sort([scene.score for scene in scenes if not scene.disturbance])[::-1]
    return float(scores[budget_size(BUDGET, len(scores)) - 1]) if len(scores) else 1.0


def by_disturbance(scenes: Sequence[SceneRow]) -> dict[str, FalseAlarmShare]:
    """Count failure-free scenes above that score, by disturbance; scenes of hard logs apart."""
    threshold = budget_threshold(scenes)
    quiet = [scene for scene in scenes if not scene.fails]
    groups: dict[str, list[SceneRow]] = {}
    for scene in quiet:
        groups.setdefault(scene.disturbance or NOTHING, []).append(scene)
    groups["hard log"] = [scene for scene in quiet if scene.hard and not scene.disturbance]
    return {name: _share(group, threshold) for name, group in sorted(groups.items())}


def slip_false_alarms(
    scenes: Sequence[SceneRow], again: Sequence[SceneRow]
) -> FalseAlarmShare | None:
    """Count scenes that were mined again with a slip in each, against the same score."""
    if not again:
        return None
    return _share([scene for scene in again if not scene.fails], budget_threshold(scenes))


def _share(scenes: Sequence[SceneRow], threshold: float) -> FalseAlarmShare:
    above = sum(scene.score > threshold for scene in scenes)
    return FalseAlarmShare(
        scenes=len(scenes),
        above=above,
        share=round(above / len(scenes), 4) if scenes else None,
        threshold=round(threshold, 4),
    )
