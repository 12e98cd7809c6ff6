"""Sensor rows: rows of a range image measured from a frame, one per beam or evenly spaced."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from schemas.frame import LidarFrame
from workers.lidar.range_image import SensorProfile, project

MULTIPLE: Final = 16
"""Factor of the number of rows: SalsaNext and LMNet halve an image four times."""

MAX_BEAMS: Final = 256

_EVEN_QUANTILES: Final = (0.001, 0.999)
"""Quantiles of elevation that bound even rows; points beyond are outliers, not beams."""

_RECORDED_SHARE: Final = 0.9
_ORDERED_SHARE: Final = 0.95
_MIN_BEAM_POINTS: Final = 20
_FEWEST_BEAMS: Final = 4
_FEWEST_POINTS: Final = 1000
_AS_MANY: Final = 0.01
"""Share of points by which even rows must show more to be preferred to a row per beam."""

_FROM_M: Final = 3.0
"""Smallest range for elevations, metres; nearer points deviate by the beams' origin and the car's
own roof."""


def lay_out(profile: SensorProfile, frame: LidarFrame) -> SensorProfile:
    """Set a profile's rows to those of the sensor of a frame.

    There is a row for each beam where beams can be separated, are not more than the profile's
    rows, and show as many points as evenly spaced rows. Otherwise the profile's number of rows is
    spaced evenly over the elevations of nearly all points.

    Args:
        profile: If it is `fitted`, its rows are the maximum.
        frame: A frame of the sensor.

    Returns:
        The profile with rows and field of view, no longer `fitted`. It is returned unchanged if it
        was not fitted, or if the frame has too few points.
    """
    if not profile.fitted:
        return profile
    points_m = frame.points_m[frame.valid_mask]
    far = np.linalg.norm(points_m, axis=1) > _FROM_M
    if far.sum() < _FEWEST_POINTS:
        return profile
    elevation_deg = elevations_deg(points_m[far])
    rows = evenly_spaced(elevation_deg, profile.rows, profile.columns)
    beam = beam_of_points(frame)
    if beam is not None:
        listed = elevation_of_beams(elevation_deg, beam[far])
        if _FEWEST_BEAMS <= len(listed) <= profile.rows:
            each = one_row_each(listed, profile.columns)
            if seen_share([points_m], each) > seen_share([points_m], rows) - _AS_MANY:
                rows = each
    return replace(
        profile,
        rows=rows.rows,
        fov_up_deg=rows.fov_up_deg,
        fov_down_deg=rows.fov_down_deg,
        elevations_deg=rows.elevations_deg,
        fitted=False,
    )


def beam_of_points(frame: LidarFrame) -> NDArray[np.int64] | None:
    """Return the beam of each valid point: as recorded, or the revolution of the cloud it is in."""
    ring = frame.ring[frame.valid_mask]
    if len(ring) and (ring >= 0).mean() > _RECORDED_SHARE:
        return ring.astype(np.int64)
    x, y, _ = frame.points_m[frame.valid_mask].T.astype(np.float64)
    azimuth = np.arctan2(y, x)
    step = (np.diff(azimuth) + np.pi) % (2 * np.pi) - np.pi
    turned = np.concatenate(([0.0], np.cumsum(step))) / (2 * np.pi)
    turns = abs(turned[-1]) if len(ring) else 0.0
    if not 2 < turns < MAX_BEAMS or (step * turned[-1] >= 0).mean() < _ORDERED_SHARE:
        return None
    return np.floor(np.abs(turned) + 1e-6).astype(np.int64)


def elevation_of_beams(
    elevation_deg: NDArray[np.float64], beam: NDArray[np.int64]
) -> tuple[float, ...]:
    """Return the median elevation of each beam with enough points, falling; equal ones once."""
    elevation_deg, beam = elevation_deg[beam >= 0], beam[beam >= 0]
    order = np.lexsort((elevation_deg, beam))
    counts = np.bincount(beam)
    start = np.concatenate(([0], np.cumsum(counts)))[:-1]
    known = counts >= _MIN_BEAM_POINTS
    middle = elevation_deg[order][start[known] + counts[known] // 2]
    return tuple(np.unique(np.round(middle, 3))[::-1].tolist())


def one_row_each(beams_deg: tuple[float, ...], columns: int) -> SensorProfile:
    """Build a profile of one row per beam, with further rows above up to a valid number."""
    gap = beams_deg[0] - beams_deg[1]
    missing = whole_rows(len(beams_deg)) - len(beams_deg)
    above = [round(beams_deg[0] + gap * more, 3) for more in range(missing, 0, -1)]
    rows = (*above, *beams_deg)
    return SensorProfile(
        name="a row for each beam",
        rows=len(rows),
        columns=columns,
        fov_up_deg=round(rows[0] + gap / 2, 2),
        fov_down_deg=round(rows[-1] - (rows[-2] - rows[-1]) / 2, 2),
        elevations_deg=rows,
    )


def evenly_spaced(elevation_deg: NDArray[np.float64], beams: int, columns: int) -> SensorProfile:
    """Build a profile of even rows over the elevations of nearly all points."""
    down, up = np.quantile(elevation_deg, _EVEN_QUANTILES).tolist()
    half = (up - down) / (beams - 1) / 2
    return SensorProfile(
        name="evenly spaced rows",
        rows=whole_rows(beams),
        columns=columns,
        fov_up_deg=round(up + half, 2),
        fov_down_deg=round(down - half, 2),
    )


def whole_rows(rows: int) -> int:
    """Round up to a number of rows that the networks accept."""
    return -(-rows // MULTIPLE) * MULTIPLE


def seen_share(clouds: Sequence[Points], profile: SensorProfile) -> float:
    """Compute the share of points that are the nearest in their pixel."""
    seen = [int(project(cloud, profile).seen_mask.sum()) for cloud in clouds]
    return sum(seen) / max(sum(map(len, clouds)), 1)


def elevations_deg(points_m: Points) -> NDArray[np.float64]:
    """Return the elevation of each point over the plane of the sensor, degrees."""
    flat = np.hypot(points_m[:, 0], points_m[:, 1])
    return np.degrees(np.arctan2(points_m[:, 2].astype(np.float64), flat))
