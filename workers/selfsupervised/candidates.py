"""Motion candidates: clusters that fit earlier frames better after a shift.

`verification.py` then tests each candidate against free space.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask
from workers.selfsupervised.registration import RegistrationResiduals

MIN_SPEED_M_PER_S: Final = 0.7
"""Half a brisk walk. Over 0.5 s it is 0.35 m, three times what sampling and pose noise imitate."""

LONG_M: Final = 5.0
"""Length from which a cluster at 3 m/s leaves less than a third of its place in 0.5 s, metres."""

GOOD_FIT_FAR_M: Final = 0.22
GOOD_FIT_NEAR_M: Final = 0.12
"""Mean nearest distance of a good fit, metres, after 0.5 s and after 0.1 s.

An object that turns and shows other sides fits worse after the longer time."""

_MIN_GAIN_M: Final = 0.02
_MIN_GAIN_SHARE: Final = 0.25
_WEAK_GAIN_SHARE: Final = 0.10
_MIN_GAIN_NEAR_M: Final = 0.15
_MAX_CLIMB_M: Final = 0.6
_MAX_SPEED_CHANGE: Final = 2.0
_MAX_SPEED_CHANGE_SHARE: Final = 0.3
_SAME_FIT_M: Final = 0.02
"""Difference of two energies that counts as equal, metres.

The side of a passing object fits the near frame at any shift along it, so that frame cannot refute
the motion."""

_MIN_SHORT_SPEED: Final = 3.0
_SAME_SPEED_M_PER_S: Final = 0.5
_SAME_SPEED_SHARE: Final = 0.2


def same_velocity(velocity: NDArray[np.float32], known: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return (K,) the velocities that differ from the known ones by no more than their errors."""
    change = np.linalg.norm(velocity - known, axis=1)
    same: Mask = change < _SAME_SPEED_M_PER_S + _SAME_SPEED_SHARE * np.linalg.norm(known, axis=1)
    return same


def far_candidates(
    fit: RegistrationResiduals,
    velocity_far: NDArray[np.float32],
    velocity_near: NDArray[np.float32],
) -> tuple[Mask, Mask]:
    """Return the clusters that moved over 0.5 s, and those with a clearly better fit when shifted.

    A slow body overlaps its earlier place and gains little from a shift: it needs free space at
    both ends of its motion, the clear ones at one end.
    """
    speed = np.linalg.norm(velocity_far, axis=1)
    change = np.linalg.norm(velocity_near - velocity_far, axis=1)
    steady = change < _MAX_SPEED_CHANGE + _MAX_SPEED_CHANGE_SHARE * speed
    gain = fit.still_energy_far - fit.energy_far
    moves: Mask = (
        fit.tried
        & (fit.energy_far < GOOD_FIT_FAR_M)
        & (gain > _MIN_GAIN_M + _WEAK_GAIN_SHARE * fit.still_energy_far)
        & (speed >= MIN_SPEED_M_PER_S)
        & (np.abs(fit.shift_far_m[:, 2]) < _MAX_CLIMB_M)
        & (steady | (fit.energy_between < fit.energy_near + _SAME_FIT_M))
    )
    clear: Mask = moves & (gain > _MIN_GAIN_M + _MIN_GAIN_SHARE * fit.still_energy_far)
    return moves, clear


def near_hints(fit: RegistrationResiduals, velocity_near: NDArray[np.float32]) -> Mask:
    """Return the clusters that fit the near frame clearly better after a shift.

    It is no evidence of motion alone, since newly uncovered surfaces fit so as well. It bears out
    a motion that is already known.
    """
    gain = fit.still_energy_near - fit.energy_near
    hints: Mask = (
        fit.tried
        & (fit.energy_near < GOOD_FIT_NEAR_M)
        & (gain > _MIN_GAIN_M + _MIN_GAIN_SHARE * fit.still_energy_near)
        & (np.linalg.norm(velocity_near, axis=1) >= MIN_SPEED_M_PER_S)
    )
    return hints


def near_candidates(fit: RegistrationResiduals, velocity_near: NDArray[np.float32]) -> Mask:
    """Return the clusters that moved over 0.1 s and were not visible half a second ago."""
    speed = np.linalg.norm(velocity_near, axis=1)
    moves: Mask = (
        fit.tried
        & (fit.energy_near < GOOD_FIT_NEAR_M)
        & (fit.still_energy_near - fit.energy_near > _MIN_GAIN_NEAR_M)
        & (speed >= _MIN_SHORT_SPEED)
        & (fit.energy_far >= GOOD_FIT_FAR_M)
    )
    return moves
