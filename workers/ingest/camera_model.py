"""Camera model: projection of lidar points into one image, with lens distortion."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform

MIN_DEPTH_M: Final = 0.1
"""Depth below which points are in no image, metres: too close to the camera's plane, or behind it.
"""

FISHEYE_MODELS: Final = ("equidistant", "fisheye", "kannala_brandt")


@dataclass(frozen=True, slots=True, eq=False)
class CameraView:
    """One image of a calibrated camera, and the projection of the lidar's points into it.

    Attributes:
        topic: MCAP topic of the image.
        stamp_ns: Of the image, nanoseconds since the Unix epoch.
        image_bytes: As recorded, compressed.
        image_format: As recorded: `jpeg`, `png`.
        width: Pixels of the image.
        height: Pixels of the image.
        pixel_from_camera: (3, 4) projection, scaled to the image's size.
        distortion_model: ROS's name; used only where `distortion` is not empty.
        distortion: Coefficients; empty for a rectified image.
        camera_from_lidar: (4, 4) lidar's sensor space to the camera's (x right, y down, z ahead).
    """

    topic: str
    stamp_ns: int
    image_bytes: bytes
    image_format: str
    width: int
    height: int
    pixel_from_camera: NDArray[np.float64]
    distortion_model: str
    distortion: tuple[float, ...]
    camera_from_lidar: Transform

    def project(self, points_m: Points) -> tuple[NDArray[np.float64], Mask]:
        """Project points of the lidar into the image.

        Args:
            points_m: (N, 3) sensor space of the lidar, metres.

        Returns:
            (N, 2) pixels, u right and v down, and (N,) true where the point is ahead of the camera
            and inside the image. Pixels mean nothing where it is false.
        """
        camera = self.camera_from_lidar
        xyz = points_m.astype(np.float64) @ camera[:3, :3].T + camera[:3, 3]
        ahead_mask = xyz[:, 2] > MIN_DEPTH_M
        xyz[~ahead_mask] = (0.0, 0.0, 1.0)
        if self.distortion:
            xyz[:, :2] = xyz[:, 2:] * distort(
                xyz[:, :2] / xyz[:, 2:], self.distortion, model=self.distortion_model
            )
        projected = xyz @ self.pixel_from_camera[:, :3].T + self.pixel_from_camera[:, 3]
        pixels = projected[:, :2] / projected[:, 2:]
        inside_mask = ((pixels >= 0) & (pixels < (self.width, self.height))).all(axis=1)
        return pixels, ahead_mask & inside_mask


def distort(
    normalised: NDArray[np.float64], coefficients: tuple[float, ...], *, model: str
) -> NDArray[np.float64]:
    """Apply the distortion of the lens to ideal rays.

    The rational model of eight coefficients contains `plumb_bob`'s five (OpenCV, calib3d); the
    fisheye model is Kannala and Brandt's. A polynomial fitted to the image is not monotonic outside
    it, and would map rays from far aside into the image: such rays become infinite instead.

    Args:
        normalised: (N, 2) x/z and y/z in the camera's space.
        coefficients: k1 k2 p1 p2 k3 k4 k5 k6, or k1 k2 k3 k4 of a fisheye; missing ones are zero.
        model: ROS's name of it.

    Returns:
        (N, 2) x/z and y/z after distortion; infinite outside the lens's field of view.
    """
    radius = np.hypot(normalised[:, 0], normalised[:, 1])
    if model in FISHEYE_MODELS:
        k1, k2, k3, k4 = _padded(coefficients, 4)
        angle = np.arctan(radius)
        bent = angle * np.polynomial.polynomial.polyval(angle**2, (1.0, k1, k2, k3, k4))
        stretch = np.divide(bent, radius, out=np.ones_like(radius), where=radius > 0)
        slope = np.polynomial.polynomial.polyval(angle**2, (1.0, 3 * k1, 5 * k2, 7 * k3, 9 * k4))
        return np.where((slope > 0)[:, None], normalised * stretch[:, None], np.inf)
    k1, k2, p1, p2, k3, k4, k5, k6 = _padded(coefficients, 8)
    squared = radius**2
    stretch = np.polynomial.polynomial.polyval(squared, (1.0, k1, k2, k3))
    stretch /= np.polynomial.polynomial.polyval(squared, (1.0, k4, k5, k6))
    x, y = normalised.T
    bent = normalised * stretch[:, None]
    bent[:, 0] += 2 * p1 * x * y + p2 * (squared + 2 * x * x)
    bent[:, 1] += p1 * (squared + 2 * y * y) + 2 * p2 * x * y
    return np.where((radius <= _turning_radius(coefficients))[:, None], bent, np.inf)


def _turning_radius(coefficients: tuple[float, ...]) -> float:
    """Return the largest radius up to which the radial polynomial increases."""
    k1, k2, _, _, k3, k4, k5, k6 = _padded(coefficients, 8)
    radius = np.linspace(0.0, 5.0, 2001)
    squared = radius**2
    bent = radius * np.polynomial.polynomial.polyval(squared, (1.0, k1, k2, k3))
    bent /= np.polynomial.polynomial.polyval(squared, (1.0, k4, k5, k6))
    falls = np.flatnonzero(np.diff(bent) <= 0)
    return float(radius[falls[0]]) if len(falls) else float("inf")


def _padded(coefficients: tuple[float, ...], count: int) -> tuple[float, ...]:
    return (*coefficients, *(0.0,) * count)[:count]
