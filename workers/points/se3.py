"""Rigid transforms of points: application, inversion, change of space."""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points, Transform


def transform(to_from_from: Transform, points: NDArray[np.floating]) -> Points:
    """Map points from one space to another.

    The product is computed in float64, because poses far from the origin lose millimetres in
    float32.

    Args:
        to_from_from: (4, 4) rigid transform that maps points of the second space to the first.
        points: (N, 3) in the second space, metres.

    Returns:
        (N, 3) float32 in the first space, metres.
    """
    rotated = points.astype(np.float64, copy=False) @ to_from_from[:3, :3].T
    return (rotated + to_from_from[:3, 3]).astype(np.float32)


def inverse(to_from_from: Transform) -> Transform:
    """Invert a rigid transform exactly: transpose the rotation, no matrix inversion.

    Args:
        to_from_from: (4, 4) rigid transform.

    Returns:
        (4, 4) `from_from_to`.
    """
    rotation = to_from_from[:3, :3].T
    turned: Transform = np.eye(4)
    turned[:3, :3] = rotation
    turned[:3, 3] = -rotation @ to_from_from[:3, 3]
    return turned
