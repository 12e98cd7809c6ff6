"""Answers of the model under test on both sides of a comparison. Pure.

What a model does not label cannot contradict, so a version that falls silent would pass the gate.
"""

from collections.abc import Sequence
from typing import Final

from service.curation.compared_scenes import ComparedScene, Matched
from service.curation.comparison import SideOf
from service.curation.comparison_rates import Amount, per_hour
from service.curation.comparison_statistics import LEVEL, quantile

MOST_LESS: Final = 0.05
"""Share of the returns by which B may label less than A, at the lower bound of the interval."""


def labelled_share(scenes: Sequence[ComparedScene]) -> float:
    """Return the share of the returns that the supervised stream labels, by time driven."""
    hours = sum(scene.hours for scene in scenes)
    return sum(scene.labelled_share * scene.hours for scene in scenes) / hours if hours else 1.0


def answers_less(matched: Matched) -> bool:
    """Return true if B labels a smaller share than A on the same logs or kinds of road.

    The lower bound of the 95 % interval of the difference, by log, exceeds `MOST_LESS`.
    """
    found = per_hour(
        matched,
        [*_silent("a", matched.a), *_silent("b", matched.b)],
        groups=1,
        tolerance=0.0,
    )
    difference = float(found.rate_b[0] - found.rate_a[0])
    return difference - quantile(LEVEL) * float(found.error[0]) > MOST_LESS


def _silent(side: SideOf, scenes: Sequence[ComparedScene]) -> list[Amount]:
    """Return the time of each scene in which nothing is labelled, hours."""
    return [
        Amount(side, scene, 0, scene.hours * (1.0 - scene.labelled_share))
        for scene in scenes
        if scene.labelled_share < 1.0
    ]
