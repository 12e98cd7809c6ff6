"""How well the ranking of the demo's fleet finds what was planted in it, beside other rankings."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from schemas.score import SceneScore
from service.demo.planted import DemoScene

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


def found_in(scenes: Sequence[DemoScene]) -> list[RankingFound]:
    """Say how well each way to rank the scenes finds those with a planted failure."""
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
