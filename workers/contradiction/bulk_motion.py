"""Bulk motion: thousands of points that a motion source confirms to move together.

A lorry at 3 m/s covers its own shape for seconds, its box is long, and the visible part of it
hardly goes anywhere within half a second. These observations speak against the few points of a
sliver. They say nothing against thousands of points whose motion free space proved more than once.
"""

from typing import Final

from workers.contradiction.clamp import clamp01

_FEW_POINTS: Final = 500.0
_MANY_POINTS: Final = 2_000.0
"""Median points per frame from which on motion is in bulk, and from which on it is so in full.

A car within 15 m has a thousand. Slivers of static structure, rims and spray stay below five
hundred."""

_LEAST_SPEED_M_PER_S: Final = 1.1
"""Measured speed from which on motion counts in full: 4 km/h, the paper's threshold."""


def bulk_motion_of(
    *, points: float, confirmed: float, speed_m_per_s: float, pose_doubted: float
) -> float:
    """Return the evidence that an object moves in bulk, 0 to 1.

    Args:
        points: Median points per frame.
        confirmed: Share of its points whose motion was confirmed more than once.
        speed_m_per_s: Median of its measured speeds; 0 when none was measured.
        pose_doubted: Share of its frames whose pose is not healthy: a slip moves whole facades.
    """
    many = clamp01((points - _FEW_POINTS) / (_MANY_POINTS - _FEW_POINTS))
    fast_enough = clamp01(speed_m_per_s / _LEAST_SPEED_M_PER_S)
    return many * confirmed * fast_enough * (1.0 - pose_doubted)
