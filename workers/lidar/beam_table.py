"""Beam table: elevations of a sensor's beams, measured from its clouds; rows of the range image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.lidar.beam_origin import MAX_HIDDEN_SHARE, find_origin, hidden_share

MIN_RANGE_M = 2.5
"""Smallest range of a return, metres; nearer ones are the car itself or reflections."""

_MIN_RING_POINTS = 20
_MAX_CONE_ERROR = 0.35
"""Spread of a beam's elevation over the spacing of beams, above which rings are no cones.

A point would then fall in the wrong row more often than not."""

_MIN_SPACING = 1e-3
"""Smallest spacing of tangents, 0.06 degrees: half of the closest beams on the market. Closer ones
are one beam, or one place."""

_SECTOR_RAD = np.radians(0.5)


@dataclass(frozen=True, slots=True, eq=False)
class BeamTable:
    """Elevations of a sensor's beams about their common origin.

    Attributes:
        tangents: (R,) tangent of each beam's elevation, rising.
        origin_m: (3,) origin of the beams, in the space of the cloud.
        max_gap: Largest difference of neighbouring tangents that still bracket the space between.
        trusted: The beams are cones about the origin, so that visibility can be computed.
        reason: Why they are not; empty when they are.
    """

    tangents: NDArray[np.float32]
    origin_m: NDArray[np.float64]
    max_gap: float
    trusted: bool = True
    reason: str = ""


def estimate_beam_table(points_m: Points, ring: NDArray[np.int16]) -> BeamTable:
    """Measure the beams of the sensor that recorded a cloud.

    Recorded beams must be cones about the sensor. If they are not cones about the cloud's origin,
    their common apex is estimated, since clouds are often delivered in the space of the car.
    Without recorded beams the rows are evenly spaced, at the distance of vertical neighbours in the
    cloud. The cloud's origin is then used unless points hide each other from there; in that case
    the place from which they do not is estimated.

    Args:
        points_m: (N, 3) valid points, metres.
        ring: (N,) recorded beam of each; -1 where unknown.
    """
    distance = np.linalg.norm(points_m, axis=1)
    usable = distance > MIN_RANGE_M
    points, beams = points_m[usable].astype(np.float64), ring[usable]
    if len(points) < _MIN_RING_POINTS:
        return BeamTable(
            np.zeros(0, np.float32), np.zeros(3), 0.0, trusted=False, reason="too few points"
        )
    counts = np.bincount(beams[beams >= 0])
    known = np.flatnonzero(counts >= _MIN_RING_POINTS)
    if len(known) >= 4 and counts[known].sum() > 0.9 * len(points):
        return _from_rings(points, beams, known)
    return _evenly_spaced(points)


def _from_rings(
    points: NDArray[np.float64], beams: NDArray[np.int16], known: NDArray[np.int64]
) -> BeamTable:
    row_of = np.full(int(beams.max()) + 1, -1)
    row_of[known] = np.arange(len(known))
    inside = (beams >= 0) & (row_of[np.maximum(beams, 0)] >= 0)
    points, rows = points[inside], row_of[beams[inside]]
    origin = np.zeros(3)
    tangents, error = _cones(points, rows, len(known))
    if error > _MAX_CONE_ERROR:
        origin = _meeting_point(points, rows, len(known))
        tangents, error = _cones(points - origin, rows, len(known))
    spacing = float(np.median(np.diff(np.sort(tangents))))
    reason = "recorded beams are no cones about any point" if error > _MAX_CONE_ERROR else ""
    if not reason and spacing < _MIN_SPACING:
        reason = f"{len(known)} recorded beams look the same way"
    return BeamTable(
        np.sort(tangents).astype(np.float32),
        origin,
        _max_gap(tangents),
        trusted=not reason,
        reason=reason,
    )


def _cones(
    points: NDArray[np.float64], rows: NDArray[np.int64], count: int
) -> tuple[NDArray[np.float64], float]:
    """Return the median tangent of each beam, and the typical spread over the typical spacing."""
    tangent = points[:, 2] / np.maximum(np.hypot(points[:, 0], points[:, 1]), 0.1)
    order = np.lexsort((tangent, rows))
    start = np.searchsorted(rows[order], np.arange(count + 1))
    # a last beam without a point would begin after the last one
    middle = np.minimum((start[:-1] + start[1:]) // 2, len(tangent) - 1)
    quarter = (start[1:] - start[:-1]) // 4
    ranked = tangent[order]
    tangents = ranked[middle]
    spread = (ranked[middle + quarter] - ranked[middle - quarter]) / 2
    spacing = np.median(np.diff(np.sort(tangents)))
    return tangents, float(np.median(spread) / max(spacing, 1e-4))


def _meeting_point(
    points: NDArray[np.float64], rows: NDArray[np.int64], count: int
) -> NDArray[np.float64]:
    """Estimate the apex of the beams: z - oz = tangent * horizontal distance from (ox, oy).

    Gauss-Newton on the origin with the tangents eliminated beam by beam and outliers down-weighted.
    """
    points, rows = points[::5], rows[::5]
    origin = np.zeros(3)
    for _ in range(30):
        from_origin = points - origin
        distance = np.maximum(np.hypot(from_origin[:, 0], from_origin[:, 1]), 0.1)
        tangents, _ = _cones(from_origin, rows, count)
        angle = (from_origin[:, 2] - tangents[rows] * distance) / distance
        scale = 1.5 * float(np.median(np.abs(angle))) + 1e-4
        weight = 1.0 / (1.0 + (angle / scale) ** 2)
        slope = tangents[rows] / distance
        # how the angular error changes with the origin, and (a constant) with the tangent
        jacobian = np.column_stack(
            [slope * from_origin[:, 0], slope * from_origin[:, 1], -np.ones(len(points))]
        )
        jacobian /= distance[:, None]
        total = np.maximum(np.bincount(rows, weight, count), 1e-9)
        for column in (*jacobian.T, angle):
            column -= (np.bincount(rows, weight * column, count) / total)[rows]
        normal = jacobian.T @ (weight[:, None] * jacobian) + 1e-9 * np.eye(3)
        step = np.linalg.solve(normal, -jacobian.T @ (weight * angle))
        origin = origin + step
        if np.linalg.norm(step) < 1e-3:
            break
    return origin


def _evenly_spaced(points: NDArray[np.float64]) -> BeamTable:
    origin, reason = np.zeros(3), ""
    behind = hidden_share(points, origin)
    if behind > MAX_HIDDEN_SHARE:
        found = find_origin(points)
        if found is None:
            reason = (
                f"{behind:.0%} of the points that look the same way hide each other, and from no "
                "one place do they not: clouds of several sensors, or moved ones"
            )
        else:
            origin = found
    points = points - origin
    distance = np.hypot(points[:, 0], points[:, 1])
    elevation = np.arctan2(points[:, 2], distance)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    sector = np.floor(azimuth / _SECTOR_RAD).astype(np.int64)
    order = np.lexsort((elevation, sector))
    gaps = np.diff(elevation[order])[np.diff(sector[order]) == 0]
    # a sector is wider than a step of azimuth, so a beam may hit twice: those gaps are tiny
    gaps = gaps[gaps > np.radians(0.1)]
    if len(gaps) == 0:
        return BeamTable(
            np.zeros(0, np.float32), np.zeros(3), 0.0, trusted=False, reason="one row of points"
        )
    spacing = max(float(np.median(gaps)), float(np.radians(0.15)))
    low, high = np.quantile(elevation, [0.001, 0.999])
    tangents = np.tan(np.arange(low, high + spacing, spacing))
    return BeamTable(
        tangents.astype(np.float32),
        origin,
        _max_gap(tangents),
        trusted=not reason,
        reason=reason,
    )


def _max_gap(tangents: NDArray[np.float64]) -> float:
    """Return the gap that a surface spans unseen: 1.6 degrees, more for sparse sensors."""
    typical = float(np.median(np.diff(np.sort(tangents)))) if len(tangents) > 1 else 0.0
    return max(float(np.tan(np.radians(1.6))), 1.3 * typical)
