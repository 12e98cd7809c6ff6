"""Motion of a track over the ground: velocity, displacement and straightness."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.contradiction.clamp import clamp01
from workers.contradiction.settings import DEFAULT_FEATURES, FeatureSettings

_PATH_M: Final = 1.0
_STEADY_M: Final = 0.2
FEWEST: Final = 3
"""Least number of frames of a path."""

_END: Final = 0.01
"""Share of the points that is ignored at either end: one stray return must not move an end."""


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A straight line through the box centres of a track.

    As the car passes a static object, the observed part of it changes. The centre of this part
    moves, but one of its ends stays in place. Both ends of a moving object move.

    Attributes:
        velocity_m_per_s: (2,) velocity of the centres over the ground; zero for too few frames.
        displacement: Displacement of the end that moved less, 0 to 1: 0.5 at one metre.
        straightness: Share of the displacement in displacement and jitter of the box, 0 to 1.
    """

    velocity_m_per_s: NDArray[np.float64]
    displacement: float
    straightness: float


def velocity_of(
    centres_m: NDArray[np.float64], stamps_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the velocity (2,) of box centres over the ground; zero for too few frames.

    Args:
        centres_m: (F, 3) box centres, odom space.
        stamps_s: (F,) their times.
    """
    if len(stamps_s) < FEWEST:
        return np.zeros(2)
    time_s = stamps_s - stamps_s.mean()
    away_m = centres_m[:, :2] - centres_m[:, :2].mean(axis=0)
    spread = max(float((time_s**2).sum()), 1e-9)
    velocity: NDArray[np.float64] = (time_s[:, None] * away_m).sum(axis=0) / spread
    return velocity


def path_of(
    centres_m: NDArray[np.float64],
    stamps_s: NDArray[np.float64],
    places_m: Sequence[NDArray[np.float64]],
) -> Path:
    """Fit a straight path to the boxes of a track.

    Args:
        centres_m: (F, 3) box centres, odom space.
        stamps_s: (F,) their times.
        places_m: Points (M, 2) of each of the F boxes over the ground, M >= 1, odom space.
    """
    if len(stamps_s) < FEWEST:
        return Path(np.zeros(2), 0.0, 0.0)
    time_s = stamps_s - stamps_s.mean()
    spread = max(float((time_s**2).sum()), 1e-9)
    velocity = velocity_of(centres_m, stamps_s)
    away_m = centres_m[:, :2] - centres_m[:, :2].mean(axis=0)
    jumps_m = float(np.sqrt(((away_m - time_s[:, None] * velocity) ** 2).sum(axis=1).mean()))
    speed = float(np.linalg.norm(velocity))
    along = velocity / max(speed, 1e-9)
    ends_m = np.array([np.quantile(each @ along, (_END, 1.0 - _END)) for each in places_m])
    speeds = time_s @ (ends_m - ends_m.mean(axis=0)) / spread
    slower = max(0.0, min(speed, float(speeds.min())))
    displacement_m = slower * float(stamps_s[-1] - stamps_s[0])
    return Path(
        velocity_m_per_s=velocity,
        displacement=displacement_m / (displacement_m + _PATH_M),
        straightness=displacement_m / (displacement_m + 2.0 * jumps_m + _STEADY_M),
    )


def motion_plausibility(
    centres_m: NDArray[np.float64],
    stamps_s: NDArray[np.float64],
    velocities_m_per_s: NDArray[np.float64],
    settings: FeatureSettings = DEFAULT_FEATURES,
) -> float:
    """Return the agreement of a track's path with the measured velocity, 0 to 1.

    Args:
        centres_m: (F, 3) box centres, odom space.
        stamps_s: (F,) their times.
        velocities_m_per_s: (F, 3) measured, odom space; zero rows were not measured.
        settings: Tolerances.
    """
    measured = velocities_m_per_s[np.any(velocities_m_per_s != 0.0, axis=1)]
    if not len(measured):
        return settings.unmeasured
    velocity = np.median(measured, axis=0)
    speed = float(np.median(np.linalg.norm(measured, axis=1)))
    fast_enough = clamp01(speed / settings.slow_m_per_s)
    span_s = float(stamps_s[-1] - stamps_s[0])
    if span_s < 0.4:  # a box jumps by decimetres: too short a path says nothing
        return fast_enough * (1.0 + settings.unmeasured) / 2
    path = (centres_m[-1] - centres_m[0]) / span_s
    tolerance = settings.path_error_m_per_s + settings.path_error_share * speed
    error = float(np.linalg.norm((path - velocity)[:2])) / tolerance
    agrees = settings.implausible + (1.0 - settings.implausible) * math.exp(-(error**2))
    return fast_enough * agrees
