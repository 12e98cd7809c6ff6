"""Where the beams of a spinning lidar end among upright shapes: one compiled loop."""

from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

NOTHING_HIT: Final = -1
GROUND_HIT: Final = -2

FORM_COLUMNS: Final = ("half_length_m", "half_width_m", "low_m", "high_m", "is_round")
"""What each column of `form` means."""


ROAD_WAVES: Final = np.array(
    [
        (0.006, 2.4, 0.7, 0.3),
        (0.012, 0.5, 1.1, 1.9),
        (0.015, -0.45, 0.31, 4.0),
        (0.03, 0.17, -0.09, 5.1),
    ]
)
"""Height in metres, radians per metre along x and y, and phase of the waves a road is made of."""

_GRAZING: Final = 0.3
"""Unevenness moves no hit by more than this share of its distance."""


@numba.njit(cache=True)
def _road_height(x: float, y: float, waves: Floats) -> float:
    height = 0.0
    for k in range(len(waves)):
        height += waves[k, 0] * np.sin(waves[k, 1] * x + waves[k, 2] * y + waves[k, 3])
    return height


@numba.njit(cache=True)
def cast(
    ego: Floats,
    azimuth: Floats,
    fraction: Floats,
    tan_elevation: Floats,
    height_m: float,
    start: Floats,
    end: Floats,
    form: Floats,
    waves: Floats,
) -> tuple[Floats, NDArray[np.int32]]:
    """Find the nearest hit of every beam of every column.

    Every shape is upright, so a column of beams crosses its footprint once, over one stretch of
    horizontal distance; only heights differ between beams. That makes a frame a few milliseconds.

    Args:
        ego: (C, 3) world x, y, yaw of the sensor at each column's firing.
        azimuth: (C,) direction of each column in sensor space, radians, left is positive.
        fraction: (C,) time of each firing between `start` (0) and `end` (1).
        tan_elevation: (R,) slope of each beam.
        height_m: Sensor above z = 0, about which the road undulates.
        start: (S, 3) world x, y, yaw of each shape when the revolution begins.
        end: (S, 3) the same when it ends; it moves straight between them.
        form: (S, 5) `FORM_COLUMNS`.
        waves: (W, 4) `ROAD_WAVES`; none for a plane. On a perfect plane the rings on the road never
            change in sensor space, and odometry believes that it stands still.

    Returns:
        (C, R) horizontal distance of the nearest hit in metres, infinite where there is none, and
        (C, R) index of the shape hit, `GROUND_HIT` or `NOTHING_HIT`.
    """
    columns, rows, shapes = len(azimuth), len(tan_elevation), len(form)
    distance = np.full((columns, rows), np.inf)
    hit = np.full((columns, rows), NOTHING_HIT, dtype=np.int32)
    for c in range(columns):
        x, y = ego[c, 0], ego[c, 1]
        ux, uy = np.cos(ego[c, 2] + azimuth[c]), np.sin(ego[c, 2] + azimuth[c])
        for r in range(rows):
            if tan_elevation[r] < 0.0:
                flat = -height_m / tan_elevation[r]
                at = flat
                for _ in range(3 if len(waves) > 0 else 0):
                    rise = _road_height(x + at * ux, y + at * uy, waves)
                    shift = rise / tan_elevation[r]
                    at = flat + min(max(shift, -_GRAZING * flat), _GRAZING * flat)
                distance[c, r] = at
                hit[c, r] = GROUND_HIT
        for s in range(shapes):
            f = fraction[c]
            dx = start[s, 0] + f * (end[s, 0] - start[s, 0]) - x
            dy = start[s, 1] + f * (end[s, 1] - start[s, 1]) - y
            half_length, half_width = form[s, 0], form[s, 1]
            along, aside = dx * ux + dy * uy, dx * uy - dy * ux
            reach = half_length if form[s, 4] > 0.0 else np.hypot(half_length, half_width)
            if abs(aside) > reach or along < -reach:
                continue
            if form[s, 4] > 0.0:
                chord = np.sqrt(reach * reach - aside * aside)
                enter, leave = along - chord, along + chord
            else:
                yaw = start[s, 2] + f * (end[s, 2] - start[s, 2])
                cos, sin = np.cos(yaw), np.sin(yaw)
                px, py = -(dx * cos + dy * sin), dx * sin - dy * cos
                vx, vy = ux * cos + uy * sin, -ux * sin + uy * cos
                enter, leave = -np.inf, np.inf
                for p, v, half in ((px, vx, half_length), (py, vy, half_width)):
                    if abs(v) < 1e-12:
                        if abs(p) > half:
                            enter, leave = np.inf, -np.inf
                    else:
                        near, far = (-half - p) / v, (half - p) / v
                        if near > far:
                            near, far = far, near
                        enter, leave = max(enter, near), min(leave, far)
            if leave <= max(enter, 0.0):
                continue
            enter = max(enter, 0.0)
            low, high = form[s, 2] - height_m, form[s, 3] - height_m
            for r in range(rows):
                slope = tan_elevation[r]
                z_enter, z_leave = enter * slope, leave * slope
                if low <= z_enter <= high:
                    at = enter
                elif z_enter > high >= z_leave:
                    at = high / slope
                elif z_enter < low <= z_leave:
                    at = low / slope
                else:
                    continue
                if at < distance[c, r]:
                    distance[c, r] = at
                    hit[c, r] = s
    return distance, hit
