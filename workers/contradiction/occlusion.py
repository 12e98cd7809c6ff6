"""Occlusion test: nearest and farthest range of a frame per direction, for any beam layout."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform
from workers.points.compiled import compiled

_COLUMNS, _ROWS = 900, 150
"""Bins of direction: 0.25 to 0.5 degrees of azimuth, 1.1 degrees of elevation within +-55 degrees.

With its neighbours each bin contains a beam of a sensor with 32 rows.
"""

_PER_TANGENT = 50.0
"""Rows per unit of the tangent of elevation."""

_TINY_M = 1e-9
_NEAREST_M = 1.0
"""Least range, metres: nearer points are on the car itself."""


class RangeBounds(NamedTuple):
    """Ranges of a frame in each bin of direction and its eight neighbours.

    Attributes:
        nearest_m: (150, 900) least range of the points off the ground; infinite without one.
        farthest_m: (150, 900) greatest range of all points; 0 without a return.
    """

    nearest_m: NDArray[np.float32]
    farthest_m: NDArray[np.float32]


@compiled
def range_bounds_of(points: Points, index: NDArray[np.int64], ground: Mask) -> RangeBounds:
    """Bin chosen rows of a cloud (N, 3), sensor space, by direction; the ground mask is (N,)."""
    near = np.full((_ROWS, _COLUMNS), np.float32(np.inf))
    far = np.zeros((_ROWS, _COLUMNS), np.float32)
    for i in index:
        row, column, distance = _bin_of(points[i, 0], points[i, 1], points[i, 2])
        if distance < _NEAREST_M:
            continue
        far[row, column] = max(far[row, column], np.float32(distance))
        if not ground[i]:
            near[row, column] = min(near[row, column], np.float32(distance))
    return RangeBounds(_over_neighbours(near, True), _over_neighbours(far, False))


@compiled
def occluded_share(
    places: NDArray[np.float64], sensor_from_places: Transform, bounds: RangeBounds, margin_m: float
) -> float:
    """Return the occluded share of places (P, 3).

    A place is occluded where a point off the ground is in front of it, and no point is seen near
    it or beyond.

    Args:
        places: Places in any space, P >= 1.
        sensor_from_places: Transform to the sensor space of the frame.
        bounds: Ranges of the frame.
        margin_m: Least distance of an occluder in front of a place, metres.
    """
    hidden = 0
    to = sensor_from_places
    for p in range(len(places)):
        x, y, z = places[p, 0], places[p, 1], places[p, 2]
        row, column, distance = _bin_of(
            to[0, 0] * x + to[0, 1] * y + to[0, 2] * z + to[0, 3],
            to[1, 0] * x + to[1, 1] * y + to[1, 2] * z + to[1, 3],
            to[2, 0] * x + to[2, 1] * y + to[2, 2] * z + to[2, 3],
        )
        before_m = distance - margin_m
        if bounds.nearest_m[row, column] < before_m and bounds.farthest_m[row, column] < before_m:
            hidden += 1
    return hidden / len(places)


@compiled
def _bin_of(x: float, y: float, z: float) -> tuple[int, int, float]:
    """Return the row and column of a direction, and the range, metres.

    The tangent replaces the elevation, and the share of the way from one axis to the next the
    azimuth: angles of every point of a cloud would take most of the time.
    """
    across = np.sqrt(x * x + y * y)
    row = z / max(across, _TINY_M) * _PER_TANGENT + _ROWS / 2
    share = y / max(abs(x) + abs(y), _TINY_M)
    quarters = share if x >= 0.0 else 2.0 - share
    column = int((quarters + 1.0) * (_COLUMNS / 4)) % _COLUMNS
    return int(min(max(row, 0.0), _ROWS - 1.0)), column, np.sqrt(across * across + z * z)


@compiled
def _over_neighbours(image: NDArray[np.float32], least: bool) -> NDArray[np.float32]:
    """Return the minimum, or maximum, of each bin and its eight neighbours; columns wrap around."""
    across = image.copy()
    for row in range(_ROWS):
        for column in range(_COLUMNS):
            for side in (column - 1, (column + 1) % _COLUMNS):
                other, own = image[row, side], across[row, column]
                across[row, column] = min(own, other) if least else max(own, other)
    both = across.copy()
    for row in range(_ROWS):
        for neighbour in (row - 1, row + 1):
            if 0 <= neighbour < _ROWS:
                for column in range(_COLUMNS):
                    other, own = across[neighbour, column], both[row, column]
                    both[row, column] = min(own, other) if least else max(own, other)
    return both
