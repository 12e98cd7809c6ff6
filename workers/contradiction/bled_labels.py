"""Bled labels: static structure next to a mover in the image of the sensor, labelled with it.

A network over range images labels some pixels beyond the border of a mover. They lie on whatever is
behind it, metres away, and slide along the structure as fast as the mover passes. No object there
is labelled wrong: unlike a ghost, they are in the direction of an agreed mover. Features count them
as the rim of that mover.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from schemas.contradiction import Instance, LabelledFrame
from schemas.labels import MotionLabel

_BIN_RAD: Final = math.radians(1.5)
"""Side of a bin of direction, radians. With its neighbours it reaches 1.5 to 3 degrees: half a
metre at 10 to 20 m."""

_COLUMNS: Final = round(2.0 * math.pi / _BIN_RAD)
_ROWS: Final = round(math.pi / _BIN_RAD)


class AgreedDirections:
    """Directions of the movers that both streams label, frame by frame of a scene."""

    def __init__(self, frames: Sequence[LabelledFrame]) -> None:
        """Keep the frames of the scene; directions are marked when a frame is first asked for."""
        self._frames = frames
        self._marked: dict[int, NDArray[np.bool_]] = {}

    def share(self, members: Sequence[Instance]) -> float:
        """Return the share of a track's points in the direction of movers both streams label."""
        bled = points = 0
        for member in members:
            frame = self._frames[member.frame_index]
            if member.frame_index not in self._marked:
                self._marked[member.frame_index] = _agreed_directions(frame)
            rows, columns = _bins(frame.posed.frame.points_m[member.point_index])
            bled += int(self._marked[member.frame_index][rows, columns].sum())
            points += len(member.point_index)
        return bled / points


def _agreed_directions(frame: LabelledFrame) -> NDArray[np.bool_]:
    """Return the bins of direction next to a point that both streams label dynamic."""
    agreed = frame.semantic.labels == MotionLabel.DYNAMIC
    agreed &= frame.predictive.labels == MotionLabel.DYNAMIC
    marked = np.zeros((_ROWS, _COLUMNS), np.bool_)
    marked[_bins(frame.posed.frame.points_m[agreed])] = True
    across = marked | np.roll(marked, 1, axis=1) | np.roll(marked, -1, axis=1)
    around = across.copy()
    around[1:] |= across[:-1]
    around[:-1] |= across[1:]
    return around


def _bins(points_m: Points) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return row and column of each point's direction."""
    elevation = np.arctan2(points_m[:, 2], np.hypot(points_m[:, 0], points_m[:, 1]))
    azimuth = np.arctan2(points_m[:, 1], points_m[:, 0])
    rows = np.floor((elevation + math.pi / 2) / _BIN_RAD).astype(np.int64).clip(0, _ROWS - 1)
    columns = np.floor((azimuth + math.pi) / _BIN_RAD).astype(np.int64) % _COLUMNS
    return rows, columns
