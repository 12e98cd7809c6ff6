"""Oriented bounding boxes: upright boxes around clusters of points."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.contradiction.box_queries import areas_of

_HEADINGS_RAD: Final = np.deg2rad(np.arange(0.0, 90.0, 2.0))
_AXES: Final = np.stack(
    [np.cos(_HEADINGS_RAD), np.sin(_HEADINGS_RAD), -np.sin(_HEADINGS_RAD), np.cos(_HEADINGS_RAD)]
).reshape(2, 2, -1)
"""(2, 2, H) length and width axis, x and y, of every heading that is tried."""

MAX_BOX_POINTS: Final = 2_000
"""Points of one fit at most: more are thinned by a fixed stride, as for the 50,000 of a wall."""


def fit_box(
    points_m: NDArray[np.float32],
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Fit the upright box with the smallest ground rectangle.

    Headings are tried every two degrees: a lidar sees one or two sides of an object, which do not
    determine its heading more precisely. Principal axes would follow the denser side instead of the
    outline.

    Args:
        points_m: (N, 3) points, N >= 1, metres.

    Returns:
        Centre (3,), metres; size (3,) as length >= width and height, metres; heading of the length
        axis about z in [-pi/2, pi/2). All are in the space of the points.
    """
    points = points_m.astype(np.float64)
    thin = points[:: -(-len(points) // MAX_BOX_POINTS), :2]
    best = int(np.argmin(np.round(areas_of(thin, _AXES), 9)))
    axes = _AXES[:, :, best]
    turned = points[:, :2] @ axes.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    bottom, top = points[:, 2].min(), points[:, 2].max()
    centre_m = np.append((low + high) / 2 @ axes, (bottom + top) / 2)
    length, width = high - low
    yaw_rad = float(_HEADINGS_RAD[best])
    if width > length:
        length, width = width, length
        yaw_rad -= np.pi / 2
    return centre_m, np.array([length, width, top - bottom]), float(yaw_rad)
