"""Rotations as quaternions."""

import numpy as np
from numpy.typing import NDArray


def quaternion_wxyz(rotation: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return w, x, y, z of a rotation, w not negative.

    It is the eigenvector of the largest eigenvalue of a symmetric matrix (Bar-Itzhack, 2000).
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    symmetric = np.array(
        [
            [xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, xx - yy - zz, yx + xy, zx + xz],
            [xz - zx, yx + xy, yy - xx - zz, zy + yz],
            [yx - xy, zx + xz, zy + yz, zz - xx - yy],
        ]
    )
    found = np.linalg.eigh(symmetric)[1][:, -1]
    w, x, y, z = (found if found[0] >= 0 else -found).tolist()
    return w, x, y, z
