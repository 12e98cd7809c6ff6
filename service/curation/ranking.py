"""Ranking order of scenes, and detection of twins. Pure."""

from dataclasses import dataclass
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.contradiction import SceneState
from schemas.events import RankedScene as RankedScene

TWIN_GAP_NS: Final = NS_PER_S
"""Largest gap between neighbours, nanoseconds; no street changes within a second. The gap is one
frame period as a rule, or a short gap in the recording.
"""


@dataclass(frozen=True, slots=True)
class RankedInput:
    """Fields of a scene that ranking uses."""

    scene_id: str
    log_id: str
    start_ns: int
    end_ns: int
    score: float
    state: str

    def order(self) -> tuple[bool, float, str, int, str]:
        """Return the sort key of the ranking, best first; `store/ranking.py` sorts the same in SQL.

        Scenes that could not be judged (too short, odometry lost) come last. Equal scores are
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
    """Return the id of a better scene next to this one, the best where there are two.

    With less than `TWIN_GAP_NS` between them two scenes are neighbours. A scene without a better
    one is a peak of the score over time. Of two equal neighbours the first in the order counts as
    the better, unless neither scores at all.

    Args:
        scene: The scene.
        before: The scene of the same log and lidar with the last start before it.
        after: The scene of the same log and lidar with the first start after it.
    """
    beside = []
    if before is not None and scene.start_ns - before.end_ns < TWIN_GAP_NS:
        beside.append(before)
    if after is not None and after.start_ns - scene.end_ns < TWIN_GAP_NS:
        beside.append(after)
    better = [one for one in beside if one.score > 0 and one.order() < scene.order()]
    return min(better, key=RankedInput.order).scene_id if better else None
