"""Sensor layout: rows, columns and field of view of a range image, measured from frames."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from schemas.frame import LidarFrame
from workers.lidar.beam_table import MIN_RANGE_M, estimate_beam_table
from workers.lidar.sensor_rows import (
    MAX_BEAMS,
    MULTIPLE,
    beam_of_points,
    elevation_of_beams,
    elevations_deg,
    evenly_spaced,
    one_row_each,
    seen_share,
)

_WIDTHS: Final = (512, 1024, 2048, 4096)
_JUDGED_FRAMES: Final = 3
_STEP_RAD: Final = (np.radians(0.02), np.radians(1.5))
"""Azimuth steps of one beam, radians: smaller ones are second returns, larger ones gaps."""


@dataclass(frozen=True, slots=True)
class SensorLayout:
    """Rows and columns of a sensor.

    Attributes:
        rows: Rows of the image, a multiple of 16.
        columns: Columns of the image.
        fov_up_deg: Upper edge of the first row.
        fov_down_deg: Lower edge of the last row.
        elevations_deg: Beam elevation of each row, falling; None if rows are evenly spaced.
        beams: Number of beams; further rows lie above the topmost.
        steps_per_turn: Measured azimuth steps per revolution.
        remarks: Remarks for the user on how this was measured.
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

    Beams are identified by their recorded numbers, else by the order of the cloud if it is stored
    beam by beam, else by the spacing of elevations. Each beam gets a row if more points are visible
    then than with evenly spaced rows. Where beams do not meet in the origin of the cloud, even rows
    may be better.

    Args:
        frames: Some frames of one sensor, each with a valid point.

    Raises:
        ValueError: If they contain too few points.
    """
    if not frames:
        raise ValueError("no frame has a valid point")
    clouds = [frame.points_m[frame.valid_mask] for frame in frames]
    rings = [beam_of_points(frame) for frame in frames]
    told_apart = all(ring is not None for ring in rings)
    steps = _steps_per_turn(clouds, rings)
    columns = min(_WIDTHS, key=lambda width: abs(float(np.log(width / steps))))
    points_m = np.concatenate(clouds)
    far = np.linalg.norm(points_m, axis=1) > MIN_RANGE_M
    elevation_deg = elevations_deg(points_m[far])
    listed: tuple[float, ...] = ()
    if told_apart:
        beam = np.concatenate([ring for ring in rings if ring is not None])[far]
        listed = elevation_of_beams(elevation_deg, beam)
        beams = len(listed)
    else:
        # from a single frame: in two, points are closer to each other than beams are
        table = estimate_beam_table(clouds[0], np.full(len(clouds[0]), -1, np.int16))
        guessed = min(len(table.tangents), MAX_BEAMS)
        beams = max(round(guessed / MULTIPLE), 1) * MULTIPLE if guessed > 1 else 0
    if beams < 2:
        raise ValueError("no beams can be distinguished")
    even = evenly_spaced(elevation_deg, beams, columns)
    profiles = [one_row_each(listed, columns), even] if listed else [even]
    seen = [seen_share(clouds[:_JUDGED_FRAMES], profile) for profile in profiles]
    chosen = profiles[int(np.argmax(seen))]
    remarks = []
    if not told_apart:
        remarks.append(
            "beams are neither numbered nor in order: the number of rows follows from gaps"
        )
    elif chosen is even:
        remarks.append(
            f"rows are evenly spaced: {seen[1]:.1%} of the points are visible then, with a row for "
            f"each beam {seen[0]:.1%}; the beams do not meet in the origin of the cloud"
        )
    if chosen.rows != beams:
        remarks.append(f"{chosen.rows} rows, {beams} beams: networks need a multiple of {MULTIPLE}")
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


def _steps_per_turn(clouds: Sequence[Points], rings: Sequence[NDArray[np.int64] | None]) -> int:
    """Return the azimuth steps per turn, from the median step along a beam or along the cloud."""
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
        raise ValueError("no azimuth steps can be measured: the clouds are too sparse")
    return round(2 * np.pi / float(np.median(every)))
