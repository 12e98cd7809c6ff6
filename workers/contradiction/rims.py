"""Rims of agreed movers: contradictions along the border of an object that both label dynamic.

Labels bleed over the border of a mover by up to half a metre, and no stream errs on the object.
A rim is a thin layer next to agreed points with few points of its own. The share of agreed points
around a contradiction does not tell a rim from half of a lorry: both lie next to as many. Width and
number do.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from schemas.contradiction import Instance
from workers.contradiction.clamp import clamp01

_WIDE_SHARE: Final = 0.3
_THIN_SHARE: Final = 0.6
"""Shares of the points within about 0.6 m of an agreed point: no rim up to the first, and a rim
from the second on. Half of a car of 4.5 m has a quarter."""

_FEW_POINTS: Final = 1_000.0
_MANY_POINTS: Final = 2_000.0
"""Points per frame up to which a thin layer may be a rim, and from which on it is none: the border
of a lorry at 8 m has a few hundred."""


def rim_likeness(members: Sequence[Instance]) -> float:
    """Return how much a track resembles a rim, 0 to 1, by its width and its points.

    Args:
        members: Instances of the track.
    """
    points = np.array([len(member.point_index) for member in members], dtype=np.float64)
    next_to = float(np.average([member.rim_share for member in members], weights=points))
    thin = clamp01((next_to - _WIDE_SHARE) / (_THIN_SHARE - _WIDE_SHARE))
    few = clamp01((_MANY_POINTS - float(np.median(points))) / (_MANY_POINTS - _FEW_POINTS))
    return thin * few
