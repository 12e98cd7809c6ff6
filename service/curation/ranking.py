"""The order in which scenes deserve a look, and which are neighbours of a better one. Pure."""

from dataclasses import dataclass
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.contradiction import SceneState
from schemas.events import RankedScene as RankedScene

TWIN_GAP_NS: Final = NS_PER_S
"""Scenes closer than this are neighbours: no street changes within a second, whether the stretch
between is one frame period, as a rule, or a short gap in the recording."""


@dataclass(frozen=True, slots=True)
class RankedInput:
    """What ranking needs to know of a scene."""

    scene_id: str
    log_id: str
    start_ns: int
    end_ns: int
    score: float
    state: str

    def order(self) -> tuple[bool, float, str, int, str]:
        """Return what sorts scenes, best first: `store/ranking.py` asks the database for the same.

        Those that could not be judged (too short, odometry lost) come last; equal scores are
        ordered by log and time, so that the same scenes give the same ranking.
        """
        return (
            self.state != SceneState.SCORED,
            -self.score,
            self.log_id,
            self.start_ns,
            self.scene_id,
        )


def twin_of(
    scene: RankedInput, *, before: RankedInput | None, after: RankedInput | None
) -> str | None:
    """Name the better scene right beside this one, the best where there are two.

    With less than `TWIN_GAP_NS` between them two scenes are neighbours. What has no better one is
    a peak of the score over time. Of two equal neighbours the first in the order is taken for the
    better, unless neither scores at all.

    Args:
        scene: Which one.
        before: The scene of the same log and lidar that starts last before it.
        after: The one that starts first after it.
    """
    beside = []
    if before is not None and scene.start_ns - before.end_ns < TWIN_GAP_NS:
        beside.append(before)
    if after is not None and after.start_ns - scene.end_ns < TWIN_GAP_NS:
        beside.append(after)
    better = [one for one in beside if one.score > 0 and one.order() < scene.order()]
    return min(better, key=RankedInput.order).scene_id if better else None
