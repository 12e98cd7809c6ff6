"""Rotations as quaternions and as angles."""

from collections.abc import Sequence

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


def rotation_of_angles(angles_rad: Sequence[float], *, order: str) -> NDArray[np.float64]:
    """Return the rotation that three angles about x, y and z name.

    Args:
        angles_rad: Angles about x, y and z.
        order: `xyz`: the product of the rotations about x, y and z, as Three.js has it; `zyx`: of
            those about z, y and x, as OpenLABEL has it.
    """
    x, y, z = (float(each) for each in angles_rad)
    (cos_x, cos_y, cos_z), (sin_x, sin_y, sin_z) = np.cos([x, y, z]), np.sin([x, y, z])
    about = {
        "x": np.array([[1, 0, 0], [0, cos_x, -sin_x], [0, sin_x, cos_x]]),
        "y": np.array([[cos_y, 0, sin_y], [0, 1, 0], [-sin_y, 0, cos_y]]),
        "z": np.array([[cos_z, -sin_z, 0], [sin_z, cos_z, 0], [0, 0, 1]]),
    }
    turned: NDArray[np.float64] = np.linalg.multi_dot([about[axis] for axis in order])
    return turned


def rotation_of_quaternion(xyzw: Sequence[float]) -> NDArray[np.float64]:
    """Return the rotation of a quaternion x, y, z, w of any length but 0."""
    quaternion = np.array(xyzw, dtype=np.float64)
    length = float(np.linalg.norm(quaternion))
    if quaternion.shape != (4,) or not np.isfinite(length) or length == 0:
        raise ValueError(f"no quaternion: {list(xyzw)}")
    x, y, z, w = quaternion / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
