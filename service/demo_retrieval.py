"""How well the ranking of the demo's fleet finds what was planted in it, beside other rankings."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from schemas.score import SceneScore

BUDGETS: Final = (0.1, 0.2)
"""Of thirty scenes the first three and the first six."""


@dataclass(frozen=True, slots=True)
class RankingFound:
    """What one way to rank the scenes finds.

    Attributes:
        name: Of the way.
        ap: Average precision; None where nothing was planted.
        precision_at: By budget in percent: share of the scenes looked at that hold a failure.
    """

    name: str
    ap: float | None
    precision_at: dict[str, float]


def found_in(scenes: Sequence[SceneScore], truth: Path) -> tuple[int, list[RankingFound]]:
    """Hold rankings of a simulated fleet against what was planted.

    Args:
        scenes: All of its scenes.
        truth: Folder of its truth.

    Returns:
        How many scenes hold a planted failure, and how well each way to rank finds them.
    """
    from workers.evaluation.failures.retrieval import Retrieval, random_retrieval, retrieve
    from workers.simulation.planted_truth import PlantedTruth

    planted = {
        log_id: known.failures if (known := PlantedTruth.beside(truth / log_id)) else ()
        for log_id in {each.log_id for each in scenes}
    }
    wanted = np.array(
        [
            any(
                row.start_ns <= scene.end_ns and scene.start_ns < row.end_ns
                for row in planted[scene.log_id]
            )
            for scene in scenes
        ],
        dtype=np.bool_,
    )

    def row(name: str, found: Retrieval) -> RankingFound:
        return RankingFound(name, found.ap, found.precision_at)

    scores = np.array([scene.score for scene in scenes])
    shares = np.array([_contradicting(scene) for scene in scenes])
    return int(wanted.sum()), [
        row("counterpoint's score", retrieve(scores, wanted, BUDGETS)),
        row("share of contradicting points", retrieve(shares, wanted, BUDGETS)),
        row("a random order", random_retrieval(wanted, BUDGETS)),
    ]


def _contradicting(scene: SceneScore) -> float:
    shares = scene.nonground_points
    return shares["only_semantic_dynamic"] + shares["only_predictive_dynamic"]
