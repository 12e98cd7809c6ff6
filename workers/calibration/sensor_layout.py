"""How a lidar is laid out as an image: rows, columns, field of view, measured from frames."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from schemas.frame import LidarFrame
from workers.geometry.range_image import SensorProfile, project
from workers.selfsupervised.beam_table import MIN_RANGE_M, estimate_beam_table

MULTIPLE: Final = 16
"""SalsaNext and LMNet halve an image four times."""

_MAX_BEAMS: Final = 256
_WIDTHS: Final = (512, 1024, 2048, 4096)
_EVEN_QUANTILES: Final = (0.001, 0.999)
"""Elevations beyond are odd returns, not beams."""

_RECORDED_SHARE: Final = 0.9
_ORDERED_SHARE: Final = 0.95
_MIN_BEAM_POINTS: Final = 20
_JUDGED_FRAMES: Final = 3
_STEP_RAD: Final = (np.radians(0.02), np.radians(1.5))
"""Smaller steps are second returns of one shot, larger ones gaps in what was seen."""


@dataclass(frozen=True, slots=True)
class SensorLayout:
    """Rows and columns of a sensor.

    Attributes:
        rows: Of the image, a multiple of 16.
        columns: Of the image.
        fov_up_deg: Upper edge of the first row.
        fov_down_deg: Lower edge of the last.
        elevations_deg: Each row's beam, falling; None if rows are evenly spaced.
        beams: How many there are; further rows lie above the topmost.
        steps_per_turn: Measured steps of azimuth of a whole turn.
        remarks: What the user should know of how this was found.
    """

    rows: int
    columns: int
    fov_up_deg: float
    fov_down_deg: float
    elevations_deg: tuple[float, ...] | None
    beams: int
    steps_per_turn: int
    remarks: tuple[str, ...] = ()


def measure_layout(frames: Sequence[LidarFrame]) -> SensorLayout:
    """Measure rows and columns.

    Beams are told apart by their recorded numbers, else by the order of the cloud where it runs
    along one beam after the other, else by how elevations are spaced. A row for each beam is taken
    if more points are seen then than in evenly spaced rows: where beams do not meet in the origin
    of the cloud, even rows may be better.

    Args:
        frames: Some frames of one sensor, none without a valid point.

    Raises:
        ValueError: If they hold too few points to tell.
    """
    if not frames:
        raise ValueError("no frame has a valid point")
    clouds = [frame.points_m[frame.valid_mask] for frame in frames]
    rings = [_beam_of_points(frame) for frame in frames]
    told_apart = all(ring is not None for ring in rings)
    steps = _steps_per_turn(clouds, rings)
    columns = min(_WIDTHS, key=lambda width: abs(float(np.log(width / steps))))
    points_m = np.concatenate(clouds)
    far = np.linalg.norm(points_m, axis=1) > MIN_RANGE_M
    elevation_deg = _elevations_deg(points_m[far])
    listed: tuple[float, ...] = ()
    if told_apart:
        beam = np.concatenate([ring for ring in rings if ring is not None])[far]
        listed = _elevation_of_beams(elevation_deg, beam)
        beams = len(listed)
    else:
        # of a single frame: in two, points would lie closer to each other than beams do
        table = estimate_beam_table(clouds[0], np.full(len(clouds[0]), -1, np.int16))
        guessed = min(len(table.tangents), _MAX_BEAMS)
        beams = max(round(guessed / MULTIPLE), 1) * MULTIPLE if guessed > 1 else 0
    if beams < 2:
        raise ValueError("no beams can be told apart")
    even = _evenly_spaced(elevation_deg, beams, columns)
    profiles = [_one_row_each(listed, columns), even] if listed else [even]
    seen = [_seen_share(clouds[:_JUDGED_FRAMES], profile) for profile in profiles]
    chosen = profiles[int(np.argmax(seen))]
    remarks = []
    if not told_apart:
        remarks.append("beams are neither numbered nor in order: rows are as many as gaps suggest")
    elif chosen is even:
        remarks.append(
            f"rows are evenly spaced: {seen[1]:.1%} of the points are seen then, with a row for "
            f"each beam {seen[0]:.1%}; the beams do not meet in the origin of the cloud"
        )
    if chosen.rows != beams:
        remarks.append(f"{chosen.rows} rows, {beams} beams: networks want a multiple of {MULTIPLE}")
    return SensorLayout(
        rows=chosen.rows,
        columns=columns,
        fov_up_deg=chosen.fov_up_deg,
        fov_down_deg=chosen.fov_down_deg,
        elevations_deg=chosen.elevations_deg,
        beams=beams,
        steps_per_turn=steps,
        remarks=tuple(remarks),
    )


def _beam_of_points(frame: LidarFrame) -> NDArray[np.int64] | None:
    """Beam of each valid point: as recorded, or which turn of the cloud it belongs to."""
    ring = frame.ring[frame.valid_mask]
    if len(ring) and (ring >= 0).mean() > _RECORDED_SHARE:
        return ring.astype(np.int64)
    x, y, _ = frame.points_m[frame.valid_mask].T.astype(np.float64)
    azimuth = np.arctan2(y, x)
    step = (np.diff(azimuth) + np.pi) % (2 * np.pi) - np.pi
    turned = np.concatenate(([0.0], np.cumsum(step))) / (2 * np.pi)
    turns = abs(turned[-1]) if len(ring) else 0.0
    if not 2 < turns < _MAX_BEAMS or (step * turned[-1] >= 0).mean() < _ORDERED_SHARE:
        return None
    return np.floor(np.abs(turned) + 1e-6).astype(np.int64)


def _elevation_of_beams(
    elevation_deg: NDArray[np.float64], beam: NDArray[np.int64]
) -> tuple[float, ...]:
    """Median elevation of each beam with enough points, falling; equal ones once."""
    elevation_deg, beam = elevation_deg[beam >= 0], beam[beam >= 0]
    order = np.lexsort((elevation_deg, beam))
    counts = np.bincount(beam)
    start = np.concatenate(([0], np.cumsum(counts)))[:-1]
    known = counts >= _MIN_BEAM_POINTS
    middle = elevation_deg[order][start[known] + counts[known] // 2]
    return tuple(np.unique(np.round(middle, 3))[::-1].tolist())


def _one_row_each(elevations_deg: tuple[float, ...], columns: int) -> SensorProfile:
    """A row for each beam, and further ones above until there are enough."""
    gap = elevations_deg[0] - elevations_deg[1]
    missing = _full(len(elevations_deg)) - len(elevations_deg)
    above = [round(elevations_deg[0] + gap * more, 3) for more in range(missing, 0, -1)]
    rows = (*above, *elevations_deg)
    return SensorProfile(
        name="a row for each beam",
        rows=len(rows),
        columns=columns,
        fov_up_deg=round(rows[0] + gap / 2, 2),
        fov_down_deg=round(rows[-1] - (rows[-2] - rows[-1]) / 2, 2),
        elevations_deg=rows,
    )


def _evenly_spaced(elevation_deg: NDArray[np.float64], beams: int, columns: int) -> SensorProfile:
    """Rows over the elevations that nearly all points have."""
    down, up = np.quantile(elevation_deg, _EVEN_QUANTILES).tolist()
    half = (up - down) / (beams - 1) / 2
    return SensorProfile(
        name="evenly spaced rows",
        rows=_full(beams),
        columns=columns,
        fov_up_deg=round(up + half, 2),
        fov_down_deg=round(down - half, 2),
    )


def _full(rows: int) -> int:
    return -(-rows // MULTIPLE) * MULTIPLE


def _seen_share(clouds: Sequence[Points], profile: SensorProfile) -> float:
    seen = [int(project(cloud, profile).seen_mask.sum()) for cloud in clouds]
    return sum(seen) / max(sum(map(len, clouds)), 1)


def _elevations_deg(points_m: Points) -> NDArray[np.float64]:
    flat = np.hypot(points_m[:, 0], points_m[:, 1])
    return np.degrees(np.arctan2(points_m[:, 2].astype(np.float64), flat))


def _steps_per_turn(clouds: Sequence[Points], rings: Sequence[NDArray[np.int64] | None]) -> int:
    """Median step from a return to the next of its beam, else in the cloud, per turn."""
    steps = []
    for cloud, ring in zip(clouds, rings, strict=True):
        azimuth = np.arctan2(cloud[:, 1], cloud[:, 0])
        if ring is None:
            apart = np.abs(np.diff(azimuth))
        else:
            order = np.lexsort((azimuth, ring))
            apart = np.diff(azimuth[order])[np.diff(ring[order]) == 0]
        steps.append(apart[(apart > _STEP_RAD[0]) & (apart < _STEP_RAD[1])])
    every = np.concatenate(steps)
    if not len(every):
        raise ValueError("no steps of azimuth can be told apart: the clouds are too thin")
    return round(2 * np.pi / float(np.median(every)))
