"""Vehicle attitude on the ground: height, pitch and roll of sprung and unsprung bodies."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.lab.simulation.world.motion_along_road import TIME_STEP_S, Drive
from workers.lab.simulation.world.terrain import Terrain

Floats = NDArray[np.float64]

_HALF_WHEELBASE_M: Final = 1.4
_HALF_TRACK_M: Final = 0.8
_SPRING_S: Final = 0.12
"""Time constant over which springs and tyres smooth the ground, seconds."""

_FELT: Final = 0.2
"""Share of small unevenness that reaches a sprung body. A smooth road moves it by a tenth of a
degree at most within one revolution of the lidar."""

_DIVE_RAD_PER_M_PER_S2: Final = 0.0035
_LEAN_RAD_PER_M_PER_S2: Final = 0.0045
"""Pitch and roll per acceleration: about a degree in hard braking, slightly more in bends."""


def ride(drive: Drive, terrain: Terrain, *, seconds: float) -> Floats:
    """Simulate the motion of a sprung body along a drive.

    Returns:
        (K, 6) world x, y, z of the ground below its middle, yaw, pitch (nose down is positive) and
        roll (left side up is positive), every `TIME_STEP_S`.
    """
    time = np.arange(0.0, seconds + 1.0, TIME_STEP_S)
    x, y, yaw = drive.pose(time).T
    cos, sin = np.cos(yaw), np.sin(yaw)

    def ground(ahead_m: float, aside_m: float) -> Floats:
        east, north = x + cos * ahead_m - sin * aside_m, y + sin * ahead_m + cos * aside_m
        return terrain.height_m(east, north, felt=_FELT)

    front, rear = ground(_HALF_WHEELBASE_M, 0.0), ground(-_HALF_WHEELBASE_M, 0.0)
    left, right = ground(0.0, _HALF_TRACK_M), ground(0.0, -_HALF_TRACK_M)
    vx, vy = np.gradient(x, TIME_STEP_S), np.gradient(y, TIME_STEP_S)
    speed = cos * vx + sin * vy
    ahead = _smooth(np.gradient(speed, TIME_STEP_S), 0.3)
    turning = _smooth(speed * np.gradient(yaw, TIME_STEP_S), 0.3)
    z = _smooth((front + rear) / 2, _SPRING_S)
    pitch = np.arctan2(_smooth(rear - front, _SPRING_S), 2 * _HALF_WHEELBASE_M)
    roll = np.arctan2(_smooth(left - right, _SPRING_S), 2 * _HALF_TRACK_M)
    pitch = pitch - _DIVE_RAD_PER_M_PER_S2 * ahead
    roll = roll + _LEAN_RAD_PER_M_PER_S2 * turning
    return np.stack([x, y, z, yaw, pitch, roll], axis=1)


def place_on_terrain(poses: Floats, terrain: Terrain, *, tilts: NDArray[np.bool_]) -> Floats:
    """Place (A, 3) world x, y, yaw on the ground: (A, 6); bodies that do not tilt are upright."""
    x, y, yaw = poses.T
    cos, sin = np.cos(yaw), np.sin(yaw)
    reach = _HALF_WHEELBASE_M
    aside = _HALF_TRACK_M
    front, rear, left, right, middle = terrain.height_m(
        x + np.stack([cos * reach, -cos * reach, -sin * aside, sin * aside, 0.0 * cos]),
        y + np.stack([sin * reach, -sin * reach, cos * aside, -cos * aside, 0.0 * cos]),
    )
    z = np.where(tilts, (front + rear) / 2, middle)
    pitch = np.where(tilts, np.arctan2(rear - front, 2 * reach), 0.0)
    roll = np.where(tilts, np.arctan2(left - right, 2 * aside), 0.0)
    return np.stack([x, y, z, yaw, pitch, roll], axis=1)


def rotations(yaw: Floats, pitch: Floats, roll: Floats) -> Floats:
    """Return (..., 3, 3) world from body: roll first, then pitch, then yaw."""
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    cr, sr = np.cos(roll), np.sin(roll)
    return np.stack(
        [
            np.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr], axis=-1),
            np.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr], axis=-1),
            np.stack([-sp, cp * sr, cp * cr], axis=-1),
        ],
        axis=-2,
    )


def _smooth(values: Floats, over_s: float) -> Floats:
    half = max(round(over_s / TIME_STEP_S), 1)
    kernel = np.hanning(2 * half + 3)[1:-1]
    padded = np.pad(values, half, mode="edge")
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")
