"""The order in which scenes deserve a look, and which are neighbours of a better one. Pure."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.contradiction import SceneState
from schemas.events import RankedScene as RankedScene
from schemas.score import SceneScore

TWIN_GAP_NS: Final = NS_PER_S
"""Scenes closer than this are neighbours: no street changes within a second, whether the stretch
between is one frame period, as a rule, or a short gap in the recording."""


@dataclass(frozen=True, slots=True)
class RankedInput:
    """What ranking needs to know of a scene."""

    scene_id: str
    log_id: str
    lidar_topic: str
    start_ns: int
    end_ns: int
    score: float
    state: SceneState
    reasons: tuple[str, ...]
    sha256: str

    @classmethod
    def of(cls, score: SceneScore, *, sha256: str) -> "RankedInput":
        """Take what is needed from a decoded record and its digest."""
        return cls(
            scene_id=score.scene_id,
            log_id=score.log_id,
            lidar_topic=score.lidar_topic,
            start_ns=score.start_ns,
            end_ns=score.end_ns,
            score=score.score,
            state=score.state,
            reasons=score.reasons,
            sha256=sha256,
        )


def rank(scenes: Iterable[RankedInput], *, most: int | None = None) -> list[RankedScene]:
    """Order scenes by score, and mark those beside a better one.

    Every scene is ranked. Those that could not be judged (too short, odometry lost) come last;
    equal scores are ordered by log and time, so that the same scenes give the same ranking.

    A scene is the twin of a better neighbour: of the same log and lidar, with less than
    `TWIN_GAP_NS` between them. What remains are the peaks of the score over time. Of two equal
    neighbours the first in the order is taken for the better, unless neither scores at all.

    Args:
        scenes: In any order, ids unique.
        most: List only the first so many; None: all.

    Returns:
        Best first, ranks from 1.
    """
    ordered = sorted(scenes, key=_order)
    twin_of = _twins(ordered)
    return [
        RankedScene(
            rank=place,
            scene_id=scene.scene_id,
            log_id=scene.log_id,
            start_ns=scene.start_ns,
            end_ns=scene.end_ns,
            score=scene.score,
            reasons=scene.reasons,
            twin_of=twin_of.get(scene.scene_id),
            sha256=scene.sha256,
        )
        for place, scene in enumerate(ordered[:most], start=1)
    ]


def _order(scene: RankedInput) -> tuple[bool, float, str, int, str]:
    return (
        scene.state is not SceneState.SCORED,
        -scene.score,
        scene.log_id,
        scene.start_ns,
        scene.scene_id,
    )


def _twins(ordered: list[RankedInput]) -> dict[str, str]:
    """Map each scene that has a better neighbour to the best such neighbour."""
    by_lidar: defaultdict[tuple[str, str], list[tuple[int, int]]] = defaultdict(list)
    for place, scene in enumerate(ordered):
        by_lidar[scene.log_id, scene.lidar_topic].append((scene.start_ns, place))
    best: dict[int, int] = {}
    for its in by_lidar.values():
        for (_, one), (_, other) in pairwise(sorted(its)):
            better, worse = min(one, other), max(one, other)
            gap_ns = ordered[other].start_ns - ordered[one].end_ns
            if gap_ns < TWIN_GAP_NS and ordered[better].score > 0:
                best[worse] = min(best.get(worse, better), better)
    return {ordered[worse].scene_id: ordered[better].scene_id for worse, better in best.items()}
