"""Sensor height over the road, estimated from one cloud."""

import numpy as np
from numpy.typing import NDArray

_DEFAULT_HEIGHT_M = 1.8
_HEIGHTS_M = (0.4, 4.5)
_BIN_M = 0.05
_ROAD_SHARE = 0.5
"""Share of the commonest height's votes that the road must have.

Reflections in a wet road come from below it, but are rare; the road within 20 m is seen in columns
all around."""


def estimate_sensor_height(points_m: NDArray[np.floating]) -> float:
    """Estimate the height of the sensor: the lowest of the common heights around the car.

    Every column 0.5 m wide votes once, with its lowest point, so that walls and dense near
    returns do not outvote the road. No surface is below the road: where few beams reach it, the
    sides of cars in a jam may be commoner, but never lower.

    Args:
        points_m: (N, 3) valid points about the sensor, metres.

    Returns:
        Metres, between 0.4 and 4.5; 1.8 (a roof) without votes.
    """
    across = np.hypot(points_m[:, 0], points_m[:, 1])
    near = points_m[(across > 3.0) & (across < 20.0)]
    low, high = _HEIGHTS_M
    near = near[(near[:, 2] < -low) & (near[:, 2] > -high)]
    if len(near) == 0:
        return _DEFAULT_HEIGHT_M
    column = (np.floor(near[:, :2] / 0.5).astype(np.int64) * (1, 1 << 20)).sum(axis=1)
    order = np.lexsort((near[:, 2], column))
    lowest = near[order[np.flatnonzero(np.r_[True, np.diff(column[order]) != 0])], 2]
    votes, edges = np.histogram(-lowest, bins=np.arange(low, high + _BIN_M, _BIN_M))
    smooth = np.convolve(votes, [1, 2, 3, 2, 1], mode="same")
    best = int(np.flatnonzero(smooth >= _ROAD_SHARE * smooth.max())[-1])
    while best > 0 and smooth[best - 1] > smooth[best]:
        best -= 1
    inside = (-lowest > edges[best] - 2 * _BIN_M) & (-lowest < edges[best] + 3 * _BIN_M)
    return float(np.median(-lowest[inside]))
