"""Point sufficiency: tests if the returns of a frame can constrain a pose."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

MIN_POINTS: Final = 100


MIN_PLACES: Final = 30
"""Cells of 1.5 m (the spacing of key points) that a frame must fill to constrain six unknowns."""


_PLACE_M: Final = 1.5


_PLACE_SAMPLES: Final = 2000


_PLACE_KEYS: Final = np.array([1, 1 << 20, 1 << 40])


def too_few_returns(points_m: NDArray[np.floating], *, places: int = MIN_PLACES) -> str:
    """Return why a frame's returns cannot constrain a pose; empty when they can.

    Args:
        points_m: (N, 3) about the sensor, finite, metres.
        places: Number of cells of 1.5 m that they must fill.
    """
    if len(points_m) < MIN_POINTS:
        return f"only {len(points_m)} usable points, {MIN_POINTS} are needed"
    thinned = points_m[:: max(1, len(points_m) // _PLACE_SAMPLES)]
    cells = np.floor(thinned / _PLACE_M).astype(np.int64)
    # one number for each: whole rows take numpy twenty times as long
    found = len(np.unique(cells @ _PLACE_KEYS))
    return "" if found >= places else f"points in {found} places only"
