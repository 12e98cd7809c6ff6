"""Motions of one sensor as motions of another."""

import numpy as np

from schemas.arrays import Transform


def conjugate(new_from_old: Transform, transforms: Transform) -> Transform:
    """Say motions of one space in another, as poses of a camera become poses of the lidar.

    Args:
        new_from_old: (4, 4) where the old sensor is in the new one's space; rigid up to the digits
            it was printed with.
        transforms: (..., 4, 4) motions or poses of the old sensor.

    Returns:
        (..., 4, 4) the same motions of the new sensor.
    """
    moved: Transform = new_from_old @ transforms @ np.linalg.inv(new_from_old)
    return moved
