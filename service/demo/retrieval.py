"""Retrieval quality of the demo's ranking for planted failures, compared with other rankings."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from schemas.score import SceneScore
from service.demo.planted import DemoScene

BUDGETS: Final = (0.1, 0.2)
"""Budgets as shares of the scenes: of thirty, the first three and the first six."""


@dataclass(frozen=True, slots=True)
class RankingFound:
    """Retrieval quality of one ranking.

    Attributes:
        name: Name of the ranking.
        ap: Average precision; None without planted failures.
        precision_at: By budget in percent: share of the scenes within it that contain a failure.
    """

    name: str
    ap: float | None
    precision_at: dict[str, float]


def found_in(scenes: Sequence[DemoScene]) -> list[RankingFound]:
    """Compute the retrieval quality of each ranking for scenes with a planted failure."""
    from workers.lab.evaluation.failures.retrieval import Retrieval, random_retrieval, retrieve

    wanted = np.array([bool(scene.failures) for scene in scenes], dtype=np.bool_)

    def row(name: str, found: Retrieval) -> RankingFound:
        return RankingFound(name, found.ap, found.precision_at)

    scores = np.array([scene.record.score for scene in scenes])
    shares = np.array([_contradicting(scene.record) for scene in scenes])
    return [
        row("counterpoint's score", retrieve(scores, wanted, BUDGETS)),
        row("share of contradicting points", retrieve(shares, wanted, BUDGETS)),
        row("a random order", random_retrieval(wanted, BUDGETS)),
    ]


def _contradicting(scene: SceneScore) -> float:
    shares = scene.nonground_points
    return shares["only_semantic_dynamic"] + shares["only_predictive_dynamic"]
