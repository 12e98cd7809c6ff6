"""Settings of the score alone: a change of one computes scores again, without the logs."""

from dataclasses import dataclass
from typing import Final

from workers.contradiction.settings import FeatureSettings


@dataclass(frozen=True, slots=True)
class ScoreSettings(FeatureSettings):
    """Settings of a track's strength and a scene's score; `track_score.py` has the formula.

    Attributes:
        decay: Weight of each track relative to the stronger one before it.
        degraded_weight: Weight of a frame with a degraded pose; a lost pose has weight 0.
        lost_below: Mean weight of the frames below which a scene is `odometry_lost`.
    """

    decay: float = 0.5
    degraded_weight: float = 0.5
    lost_below: float = 0.5


DEFAULT_SCORE: Final = ScoreSettings()
