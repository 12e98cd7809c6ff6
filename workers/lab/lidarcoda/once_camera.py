"""ONCE's camera: the pixel of a point with lens distortion, and the published pixel without it."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

IMAGE_PX: Final = (1920, 1020)
"""Width and height of ONCE's pictures, pixels."""

_GRID: Final = 9
"""Points per side of the grid from which OpenCV derives the undistorted rectangle."""

_ITERATIONS: Final = 20
"""Fixed-point iterations of the inverse distortion; OpenCV uses 5, the limit is the same."""


def once_pixels(
    in_camera_m: Matrix, intrinsic: Matrix, distortion: Matrix, *, published: bool
) -> Matrix:
    """Project points of camera space into the recorded picture.

    Boxes of CODA are drawn in the recorded, distorted picture. The corrected form distorts the
    points as the lens does. The published form projects them by the camera matrix of the
    undistorted picture, which shifts them near the border.

    Args:
        in_camera_m: (N, 3) points ahead of the camera, metres.
        intrinsic: (3, 3) camera matrix.
        distortion: (4,) to (8,) coefficients k1, k2, p1, p2, k3, k4, k5, k6 of OpenCV's model.
        published: True for the published form.

    Returns:
        (N, 2) pixels.
    """
    plane = in_camera_m[:, :2] / in_camera_m[:, 2:]
    if published:
        matrix = undistorted_matrix(intrinsic, distortion)
        return plane * matrix[[0, 1], [0, 1]] + matrix[:2, 2]
    bent = distort(plane, distortion)
    return bent * intrinsic[[0, 1], [0, 1]] + intrinsic[:2, 2]


def distort(plane: Matrix, distortion: Matrix) -> Matrix:
    """Apply the lens distortion to (N, 2) points of the normalised image plane."""
    k1, k2, p1, p2, k3, k4, k5, k6 = np.pad(distortion, (0, max(0, 8 - len(distortion))))[:8]
    x, y = plane[:, 0], plane[:, 1]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return np.column_stack(
        (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )
    )


def undistorted_matrix(intrinsic: Matrix, distortion: Matrix) -> Matrix:
    """Compute the camera matrix of the undistorted picture that contains valid pixels only.

    It is the matrix that OpenCV's `getOptimalNewCameraMatrix` returns for `alpha=0`.
    """
    width, height = IMAGE_PX
    steps = np.arange(_GRID) / (_GRID - 1)
    columns, rows = np.meshgrid(steps * (width - 1), steps * (height - 1))
    grid = np.column_stack((columns.ravel(), rows.ravel()))
    plane = _undistort((grid - intrinsic[:2, 2]) / intrinsic[[0, 1], [0, 1]], distortion)
    x, y = plane[:, 0].reshape(_GRID, _GRID), plane[:, 1].reshape(_GRID, _GRID)
    left, right = x[:, 0].max(), x[:, -1].min()
    top, bottom = y[0].max(), y[-1].min()
    matrix = np.eye(3)
    matrix[0, 0] = (width - 1) / (right - left)
    matrix[1, 1] = (height - 1) / (bottom - top)
    matrix[0, 2], matrix[1, 2] = -matrix[0, 0] * left, -matrix[1, 1] * top
    return matrix


def _undistort(bent: Matrix, distortion: Matrix) -> Matrix:
    plane = bent.copy()
    for _ in range(_ITERATIONS):
        plane = plane - (distort(plane, distortion) - bent)
    return plane
