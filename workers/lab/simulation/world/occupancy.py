"""Occupancy over time: keeps simulated objects from driving through each other."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.lab.simulation.world.motion_along_road import Drive, Floats

_STEP_S: Final = 0.1
_KEEP_APART_M: Final = 1.0
_ASIDE_M: Final = 0.15


class Occupancy:
    """Bounding boxes over time; each new object is tested against all present ones."""

    def __init__(self, seconds: float) -> None:
        self._time = np.arange(0.0, seconds, _STEP_S)
        self._poses: list[Floats] = []
        self._sizes: list[tuple[float, float]] = []

    def add(self, drive: Drive, size_m: tuple[float, float, float]) -> None:
        """Add an object."""
        self._poses.append(drive.pose(self._time))
        self._sizes.append(size_m[:2])

    def is_free(self, drive: Drive, size_m: tuple[float, float, float]) -> bool:
        """Test that boxes stay a metre apart lengthwise and 0.15 m sideways."""
        if not self._poses:
            return True
        mine = drive.pose(self._time)
        length, width, _ = size_m
        sizes = np.array(self._sizes)
        reach = (np.hypot(*sizes.T) + np.hypot(length, width)) / 2 + _KEEP_APART_M
        theirs = np.stack(self._poses)
        close = (np.hypot(*(theirs - mine)[:, :, :2].transpose(2, 0, 1)) < reach[:, None]).any(1)
        return not any(
            _meet(mine, length, width, theirs[k], *self._sizes[k]) for k in np.flatnonzero(close)
        )

    def take(self, drive: Drive, size_m: tuple[float, float, float]) -> bool:
        """Add an object if there is room; return whether there was."""
        if not self.is_free(drive, size_m):
            return False
        self.add(drive, size_m)
        return True


def _meet(
    mine: Floats,
    length: float,
    width: float,
    theirs: Floats,
    other_length: float,
    other_width: float,
) -> bool:
    turn = mine[:, 2] - theirs[:, 2]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    dx, dy = (mine - theirs)[:, :2].T
    c, s = np.cos(theirs[:, 2]), np.sin(theirs[:, 2])
    along, aside = np.abs(c * dx + s * dy), np.abs(-s * dx + c * dy)
    near_along = along < (other_length + length * cos + width * sin) / 2 + _KEEP_APART_M
    near_aside = aside < (other_width + length * sin + width * cos) / 2 + _ASIDE_M
    met: NDArray[np.bool_] = near_along & near_aside
    return bool(np.any(met))
