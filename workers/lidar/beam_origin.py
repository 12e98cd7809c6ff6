"""Beam origin: the common apex of a sensor's beams, from a cloud without beam numbers."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.lidar.sensor_height import estimate_sensor_height
from workers.points.compiled import compiled

MAX_HIDDEN_SHARE: Final = 0.2
"""Share of hidden points up to which an origin is right.

From the true origin it is .01 to .07 (edges, and beams that start a few centimetres from it). From
the road under the sensor, or from the rear axle, it is .4 and more."""

_MIN_POINTS: Final = 2_000
"""Points needed for a result."""

_SHARED: Final = 0.05
"""Smallest share of points that have another in their direction.

Clouds of sensors with well-spaced beams have fewer; a shift by a centimetre would then decide."""

_COLUMN_RAD: Final = np.radians(0.2)
_ROW_RAD: Final = np.radians(0.1)
_USUAL_POINTS: Final = 100_000
"""Points of a cloud with a fifth of a point per direction; sensors of fewer points get higher rows.
"""

_LOWEST_RAD, _HIGHEST_RAD = -0.9, 0.6
_NEAREST_M, _FARTHEST_M = 3.0, 60.0
_BEHIND_M, _BEHIND_SHARE = 0.3, 0.05
"""Distance, and share of the range, from which a point is certainly behind another.

The slope of one surface within a direction stays below it."""

_X_M: Final = np.arange(-2.0, 5.1, 1.0)
"""Candidate positions along x, metres: from an origin between the axles, or in front, to a lidar on
the cab of a lorry."""

_HEIGHTS_M: Final = np.arange(0.8, 3.6, 0.02)
"""Candidate heights over the road, metres, from above a bumper to a lorry's roof.

The step is the spacing of beams at 5 m."""

_ABOVE_M: Final = 3.0
"""Height over the lowest points within 20 m, but for reflections, from which the road is measured,
metres."""

_LOWEST_SHARE: Final = 0.02

_STEPS_M: Final = (0.25, 0.1, 0.04, 0.015)
_TRIED: Final = 3
_SHARP_RAD: Final = 5e-4
_COARSE_POINTS, _FINE_POINTS = 10_000, 30_000
_SMOOTH: Final = 41


def hidden_share(points_m: NDArray[np.floating], origin_m: NDArray[np.floating]) -> float:
    """Compute the share of points behind another in the same direction.

    The base is the points that share a direction. No beam passes through a surface, so seen from
    the true origin almost none is behind another.

    Args:
        points_m: (N, 3) valid points, metres.
        origin_m: (3,) candidate origin of the beams.

    Returns:
        0 to 1; 0 with too few points.
    """
    row_rad = _ROW_RAD * max(1.0, _USUAL_POINTS / max(len(points_m), 1))
    used, shared, behind = _count(points_m, origin_m[0], origin_m[1], origin_m[2], row_rad)
    return behind / max(shared, _SHARED * used) if used >= _MIN_POINTS else 0.0


def find_origin(points_m: NDArray[np.floating]) -> NDArray[np.float64] | None:
    """Find the place about which beams are cones and no point hides another.

    About the true place the points of a beam have one elevation, so elevations concentrate on as
    many angles as there are beams. That is so up to metres to the side of it, and centimetres above
    and below. A scan of heights at a few places is followed by hill climbing. A result must see all
    points.

    Args:
        points_m: (N, 3) valid points, metres, z up.

    Returns:
        (3,) metres, space of the cloud; None if no such place is found.
    """
    road_m = _road_m(points_m)
    few, more = (points_m[:: -(-len(points_m) // most)] for most in (_COARSE_POINTS, _FINE_POINTS))
    columns = [
        max(
            (np.array([x, 0.0, road_m + height]) for height in _HEIGHTS_M),
            key=lambda origin: _sharpness(few, origin),
        )
        for x in _X_M
    ]
    columns.sort(key=lambda origin: _sharpness(few, origin), reverse=True)
    found = [_climb(more, start) for start in columns[:_TRIED]]
    low_m, high_m = road_m + _HEIGHTS_M[0], road_m + _HEIGHTS_M[-1]
    seen = [
        (sharpness, place)
        for sharpness, place in found
        if low_m <= place[2] <= high_m and hidden_share(points_m, place) <= MAX_HIDDEN_SHARE
    ]
    return max(seen, key=lambda each: each[0])[1] if seen else None


def _road_m(points_m: NDArray[np.floating]) -> float:
    near = points_m[np.hypot(points_m[:, 0], points_m[:, 1]) < 20.0]
    if len(near) == 0:
        return 0.0
    above_m = float(np.quantile(near[:, 2], _LOWEST_SHARE)) + _ABOVE_M
    return above_m - estimate_sensor_height(points_m - np.array([0.0, 0.0, above_m]))


def _climb(
    points_m: NDArray[np.floating], start: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64]]:
    """Climb one axis at a time, height last, until no step gives sharper elevations."""
    place, sharpest = start, _sharpness(points_m, start)
    for step_m in _STEPS_M:
        moved = True
        while moved:
            moved = False
            for axis in range(3):
                for length_m in (-step_m, step_m):
                    tried = place.copy()
                    tried[axis] += length_m
                    value = _sharpness(points_m, tried)
                    if value > sharpest:
                        place, sharpest, moved = tried, value, True
    return sharpest, place


def _sharpness(points_m: NDArray[np.floating], origin_m: NDArray[np.float64]) -> float:
    """Compute the concentration of elevations: squared counts over squared smoothed ones."""
    counts = _elevations(points_m, origin_m[0], origin_m[1], origin_m[2])
    smooth = np.convolve(counts, np.full(_SMOOTH, 1.0 / _SMOOTH), mode="same")
    return float((counts**2).sum() / max((smooth**2).sum(), 1e-9))


@compiled
def _elevations(
    points: NDArray[np.floating], ox: float, oy: float, oz: float
) -> NDArray[np.float64]:
    bins = int((_HIGHEST_RAD - _LOWEST_RAD) / _SHARP_RAD) + 1
    counts = np.zeros(bins, np.float64)
    for i in range(len(points)):
        x, y, z = points[i, 0] - ox, points[i, 1] - oy, points[i, 2] - oz
        across = np.sqrt(x * x + y * y)
        # nearer points amplify an origin error and the thickness of the sensor
        if 5.0 < across < _FARTHEST_M:
            k = int((np.arctan2(z, across) - _LOWEST_RAD) / _SHARP_RAD)
            if 0 <= k < bins:
                counts[k] += 1.0
    return counts


@compiled
def _count(
    points: NDArray[np.floating], ox: float, oy: float, oz: float, row: float
) -> tuple[int, int, int]:
    """Count points in range, those that share a direction, and those behind another in it."""
    columns = int(2.0 * np.pi / _COLUMN_RAD)
    rows = int((_HIGHEST_RAD - _LOWEST_RAD) / row) + 1
    nearest = np.full(rows * columns, np.float32(np.inf), np.float32)
    cell = np.full(len(points), -1, np.int64)
    distance = np.empty(len(points), np.float32)
    used = 0
    for i in range(len(points)):
        x, y, z = points[i, 0] - ox, points[i, 1] - oy, points[i, 2] - oz
        across = np.sqrt(x * x + y * y)
        length = np.sqrt(across * across + z * z)
        if not _NEAREST_M < length < _FARTHEST_M:
            continue
        k = int((np.arctan2(z, across) - _LOWEST_RAD) / row)
        if not 0 <= k < rows:
            continue
        j = min(int((np.arctan2(y, x) + np.pi) / _COLUMN_RAD), columns - 1)
        cell[i], distance[i] = k * columns + j, length
        nearest[cell[i]] = min(nearest[cell[i]], distance[i])
    taken = np.zeros(rows * columns, np.bool_)
    behind = 0
    for i in range(len(points)):
        if cell[i] >= 0:
            used += 1
            taken[cell[i]] = True
            behind += distance[i] > nearest[cell[i]] * (1.0 + _BEHIND_SHARE) + _BEHIND_M
    return used, used - taken.sum(), behind
