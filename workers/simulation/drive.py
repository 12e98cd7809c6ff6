"""How things get along: a road as a gently bending line, and drives along or across it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Instants = Floats | float

_ROAD_STEP_M: Final = 0.5
TIME_STEP_S: Final = 0.02
"""Drives are sampled this densely, and run straight between samples."""


@dataclass(frozen=True, slots=True, eq=False)
class Road:
    """The centre line of a street, sampled densely.

    Attributes:
        along_m: (K,) path length of each sample, rising.
        x_m: (K,) world.
        y_m: (K,) world.
        heading_rad: (K,) direction of the line, continuous.
    """

    along_m: Floats
    x_m: Floats
    y_m: Floats
    heading_rad: Floats

    @classmethod
    def bending(cls, *, from_m: float, to_m: float, swing_rad: float, wave_m: float) -> "Road":
        """Lay a road whose heading swings to and fro as a sine: straight where swing is 0.

        Args:
            from_m: Path length of its first point; the origin of the world lies at 0.
            to_m: Path length of its last point.
            swing_rad: Largest heading.
            wave_m: Path length of one whole swing; curvature is at most `2 pi swing / wave`.
        """
        along = np.arange(from_m, to_m + _ROAD_STEP_M, _ROAD_STEP_M)
        heading = swing_rad * np.sin(2 * np.pi * along / wave_m)
        x = np.concatenate([[0.0], np.cumsum(np.cos(heading[:-1]) * _ROAD_STEP_M)])
        y = np.concatenate([[0.0], np.cumsum(np.sin(heading[:-1]) * _ROAD_STEP_M)])
        x -= np.interp(0.0, along, x)
        y -= np.interp(0.0, along, y)
        return cls(along, x, y, heading)

    def place(self, along_m: Instants, across_m: Instants) -> tuple[Floats, Floats, Floats]:
        """Find world x, y and the road's heading at distances along and left of its centre."""
        heading = np.asarray(np.interp(along_m, self.along_m, self.heading_rad))
        across = np.asarray(across_m, dtype=np.float64)
        x = np.interp(along_m, self.along_m, self.x_m) - np.sin(heading) * across
        y = np.interp(along_m, self.along_m, self.y_m) + np.cos(heading) * across
        return x, y, heading


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Where one thing is at every time of a log.

    Attributes:
        time_s: (K,) seconds since the log began, rising.
        x_m: (K,) world.
        y_m: (K,) world.
        yaw_rad: (K,) heading, continuous.
    """

    time_s: Floats
    x_m: Floats
    y_m: Floats
    yaw_rad: Floats

    def pose(self, time_s: Instants) -> Floats:
        """Give (..., 3) world x, y and yaw at these times; outside the drive its ends hold."""
        return np.stack(
            [
                np.interp(time_s, self.time_s, self.x_m),
                np.interp(time_s, self.time_s, self.y_m),
                np.interp(time_s, self.time_s, self.yaw_rad),
            ],
            axis=-1,
        )


Knots = Sequence[tuple[float, float]]
"""(time in seconds, speed in metres per second) pairs; speed runs straight between them."""


def drive_along(
    road: Road, *, from_m: float, across_m: float, speed: Knots, seconds: float, backwards: bool
) -> Drive:
    """Drive along a lane, against the road's direction when `backwards`."""
    time, travelled = _travel(speed, seconds)
    along = from_m + (-travelled if backwards else travelled)
    x, y, heading = road.place(along, np.full_like(along, across_m))
    return Drive(time, x, y, heading + (np.pi if backwards else 0.0))


def drive_across(
    road: Road, *, at_m: float, from_across_m: float, speed: Knots, seconds: float, leftwards: bool
) -> Drive:
    """Cross the road at right angles, towards its left or its right side."""
    time, travelled = _travel(speed, seconds)
    across = from_across_m + (travelled if leftwards else -travelled)
    x, y, heading = road.place(np.full_like(across, at_m), across)
    return Drive(time, x, y, heading + (np.pi / 2 if leftwards else -np.pi / 2))


def stand(road: Road, *, at_m: float, across_m: float, turned_rad: float = 0.0) -> Drive:
    """Stay where one is: a parked car is a drive that goes nowhere."""
    x, y, heading = road.place(np.full(2, at_m), np.full(2, across_m))
    return Drive(np.array([0.0, 1.0]), x, y, heading + turned_rad)


def _travel(speed: Knots, seconds: float) -> tuple[Floats, Floats]:
    times, speeds = np.array(speed, dtype=np.float64).T
    time = np.arange(0.0, seconds + 1.0, TIME_STEP_S)
    now = np.interp(time, times, speeds)
    travelled = np.concatenate([[0.0], np.cumsum((now[1:] + now[:-1]) / 2 * TIME_STEP_S)])
    return time, travelled
