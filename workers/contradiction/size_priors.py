"""Size priors: plausibility of a box as one of a road user."""

import numpy as np
from numpy.typing import NDArray

from workers.contradiction.clamp import clamp01
from workers.contradiction.settings import DEFAULT_FEATURES, FeatureSettings


def box_plausibility(
    size_m: NDArray[np.float64], settings: FeatureSettings = DEFAULT_FEATURES
) -> float:
    """Return the plausibility of a box, 0 to 1, from its length, width and height, metres."""
    length_m, _, height_m = (float(side) for side in size_m)

    def rise(value: float) -> float:
        return clamp01((value - settings.low_m) / (settings.high_m - settings.low_m))

    long = (settings.longest_m - length_m) / (settings.longest_m - settings.long_m)
    return rise(length_m) * rise(height_m) * clamp01(long)


def not_too_long(
    size_m: NDArray[np.float64], settings: FeatureSettings = DEFAULT_FEATURES
) -> float:
    """Return 1 up to the length of a lorry with its trailer, 0 from that of a tram or facade on."""
    span_m = settings.tram_m - settings.lorry_m
    return clamp01((settings.tram_m - float(size_m[0])) / span_m)


def not_flat(
    size_m: NDArray[np.float64], range_m: float, settings: FeatureSettings = DEFAULT_FEATURES
) -> float:
    """Return 1 for a box as high for its length as road users, 0 for a flat one.

    Args:
        size_m: (3,) length, width and height, metres.
        range_m: Range, metres: few rows of beams hit a distant object, whose height is then low.
        settings: Limits.
    """
    height_m = float(size_m[2]) + settings.rows_m_per_m * range_m
    share = height_m / max(float(size_m[0]), 1e-3)
    flat = (settings.flat_share - share) / (settings.flat_share - settings.flattest_share)
    low = (settings.tall_m - height_m) / (settings.tall_m - settings.flat_below_m)
    return 1.0 - clamp01(flat) * clamp01(low)
