"""Where a track went over the ground: how far, and how straight."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

_PATH_M: Final = 1.0
_STEADY_M: Final = 0.2
_FEWEST: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A straight line through the box centres of a track.

    Attributes:
        velocity_m_per_s: (2,) over the ground; zero where there are too few frames.
        went: How far it went: half at a metre.
        straight: How much of that is a path, and how much the box jumps about.
    """

    velocity_m_per_s: NDArray[np.float64]
    went: float
    straight: float


def path_of(centres_m: NDArray[np.float64], stamps_s: NDArray[np.float64]) -> Path:
    """Fit a path.

    Args:
        centres_m: (F, 3) box centres, odom space.
        stamps_s: (F,) their times.
    """
    if len(stamps_s) < _FEWEST:
        return Path(np.zeros(2), 0.0, 0.0)
    time_s = stamps_s - stamps_s.mean()
    spread = float((time_s**2).sum())
    away_m = centres_m[:, :2] - centres_m[:, :2].mean(axis=0)
    velocity = (time_s[:, None] * away_m).sum(axis=0) / max(spread, 1e-9)
    jumps_m = float(np.sqrt(((away_m - time_s[:, None] * velocity) ** 2).sum(axis=1).mean()))
    went_m = float(np.linalg.norm(velocity)) * float(stamps_s[-1] - stamps_s[0])
    return Path(
        velocity_m_per_s=velocity,
        went=went_m / (went_m + _PATH_M),
        straight=went_m / (went_m + 2.0 * jumps_m + _STEADY_M),
    )
