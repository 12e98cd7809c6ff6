"""Bled labels: static structure next to a mover in the image of the sensor, labelled with it.

A network over range images labels some pixels beyond the border of a mover. They lie on whatever is
behind it, metres away, and slide along the structure as fast as the mover passes. No object there
is labelled wrong: unlike a ghost, they are in the direction of an agreed mover. Features count them
as the rim of that mover where the structure continues around them: a parked car next to traffic is
labelled as a whole, and nothing static of it is left.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from schemas.contradiction import Instance, LabelledFrame
from schemas.labels import MotionLabel
from workers.contradiction.clamp import clamp01

_BIN_RAD: Final = math.radians(1.5)
"""Side of a bin of direction, radians. With its neighbours it reaches 1.5 to 3 degrees: half a
metre at 10 to 20 m."""

_BLED_FROM: Final = 0.5
_BLED_ALL: Final = 0.9
"""Shares of a track in the direction of agreed movers at which none and all of it is bled label."""

_PATCH: Final = 0.3
_OBJECT: Final = 0.6
"""Values of the feature `isolation` up to which a track is a patch of a larger structure, and from
which on it is an object of its own: labels bled onto a wall have 0.1 to 0.3, parked cars 0.8 to 1.
"""

_COLUMNS: Final = round(2.0 * math.pi / _BIN_RAD)
_ROWS: Final = round(math.pi / _BIN_RAD)


def bled_likeness(bled: float, *, isolation: float) -> float:
    """Return how much a track resembles a bled label, 0 to 1.

    Args:
        bled: Share of its points in the direction of agreed movers.
        isolation: Share of the points around it that contradict in the same way.
    """
    directed = clamp01((bled - _BLED_FROM) / (_BLED_ALL - _BLED_FROM))
    return directed * clamp01((_OBJECT - isolation) / (_OBJECT - _PATCH))


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
