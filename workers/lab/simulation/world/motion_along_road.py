"""Kinematics along a road: centre lines, lanes, and drives along or across them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Instants = Floats | float

_ROAD_STEP_M: Final = 0.5
TIME_STEP_S: Final = 0.02
"""Sampling step of drives, seconds; drives are linear between samples."""


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
        """Build a road whose heading follows a sine: straight where swing is 0.

        Args:
            from_m: Path length of its first point; the origin of the world is at 0.
            to_m: Path length of its last point.
            swing_rad: Largest heading.
            wave_m: Path length of one period; curvature is at most `2 pi swing / wave`.
        """
        along = np.arange(from_m, to_m + _ROAD_STEP_M, _ROAD_STEP_M)
        heading = swing_rad * np.sin(2 * np.pi * along / wave_m)
        x = np.concatenate([[0.0], np.cumsum(np.cos(heading[:-1]) * _ROAD_STEP_M)])
        y = np.concatenate([[0.0], np.cumsum(np.sin(heading[:-1]) * _ROAD_STEP_M)])
        x -= np.interp(0.0, along, x)
        y -= np.interp(0.0, along, y)
        return cls(along, x, y, heading)

    @classmethod
    def through(cls, x_m: Floats, y_m: Floats) -> "Road":
        """Build a road through places, evenly sampled; it starts at path length 0."""
        steps = np.hypot(np.diff(x_m), np.diff(y_m))
        keep = np.concatenate([[True], steps > 1e-6])
        x_m, y_m = x_m[keep], y_m[keep]
        along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x_m), np.diff(y_m)))])
        even = np.arange(0.0, along[-1], _ROAD_STEP_M)
        x, y = np.interp(even, along, x_m), np.interp(even, along, y_m)
        heading = np.unwrap(np.arctan2(np.gradient(y), np.gradient(x)))
        return cls(even, x, y, heading)

    def crossing(self, at_m: float, *, half_m: float) -> "Road":
        """Build a straight road across this one at right angles; its path length is 0 there."""
        x, y, heading = (float(v) for v in self.place(at_m, 0.0))
        along = np.arange(-half_m, half_m + _ROAD_STEP_M, _ROAD_STEP_M)
        turned = heading + np.pi / 2
        return Road(
            along,
            x + np.cos(turned) * along,
            y + np.sin(turned) * along,
            np.full_like(along, turned),
        )

    def lane(self, across_m: float, *, backwards: bool) -> "Road":
        """Build the road along one lane, in the direction of its traffic."""
        x, y, _ = self.place(self.along_m, np.full_like(self.along_m, across_m))
        return Road.through(x[::-1], y[::-1]) if backwards else Road.through(x, y)

    def nearest_m(self, x_m: float, y_m: float) -> float:
        """Return the path length at which the road is nearest to a place."""
        return float(self.along_m[np.argmin(np.hypot(self.x_m - x_m, self.y_m - y_m))])

    @property
    def length_m(self) -> float:
        """Path length from the first to the last point."""
        return float(self.along_m[-1] - self.along_m[0])

    def place(self, along_m: Instants, across_m: Instants) -> tuple[Floats, Floats, Floats]:
        """Find world x, y and the road's heading at distances along and left of its centre."""
        heading = np.asarray(np.interp(along_m, self.along_m, self.heading_rad))
        across = np.asarray(across_m, dtype=np.float64)
        x = np.interp(along_m, self.along_m, self.x_m) - np.sin(heading) * across
        y = np.interp(along_m, self.along_m, self.y_m) + np.cos(heading) * across
        return x, y, heading


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Trajectory of one object over a log.

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
        """Return (..., 3) world x, y and yaw at these times, constant outside the drive."""
        return np.stack(
            [
                np.interp(time_s, self.time_s, self.x_m),
                np.interp(time_s, self.time_s, self.y_m),
                np.interp(time_s, self.time_s, self.yaw_rad),
            ],
            axis=-1,
        )

    def after(self, seconds: float) -> "Drive":
        """Return the same drive on a clock that begins some seconds later."""
        return Drive(self.time_s - seconds, self.x_m, self.y_m, self.yaw_rad)


Knots = Sequence[tuple[float, float]]
"""(time in seconds, speed in m/s) pairs; speed is linear between them."""


def turning_route(first: Road, leave_m: float, second: Road, enter_m: float) -> Road:
    """Build a route along one lane, over a smooth bend, and along another (`Road.lane`)."""
    until = first.along_m <= leave_m
    since = second.along_m >= enter_m
    x_0, y_0, x_1, y_1 = first.x_m[until], first.y_m[until], second.x_m[since], second.y_m[since]
    start, end = np.array([x_0[-1], y_0[-1]]), np.array([x_1[0], y_1[0]])
    out = np.array([x_0[-1] - x_0[-2], y_0[-1] - y_0[-2]])
    into = np.array([x_1[1] - x_1[0], y_1[1] - y_1[0]])
    reach = 0.39 * np.linalg.norm(end - start)
    one = start + reach * out / np.linalg.norm(out)
    two = end - reach * into / np.linalg.norm(into)
    t = np.linspace(0.0, 1.0, 60)[1:-1, None]
    bend = (1 - t) ** 3 * start + 3 * (1 - t) ** 2 * t * one + 3 * (1 - t) * t**2 * two + t**3 * end
    return Road.through(
        np.concatenate([x_0, bend[:, 0], x_1]), np.concatenate([y_0, bend[:, 1], y_1])
    )


_SIDEWAYS_M_PER_S2: Final = 2.2
_BRAKING_M_PER_S2: Final = 2.5
_WALKING_M_PER_S: Final = 0.3


def drive_with_care(
    road: Road,
    *,
    from_m: float,
    across_m: float,
    cruise_m_per_s: float,
    seconds: float,
    slow: Sequence[tuple[float, float]] = (),
    halts: Sequence[tuple[float, float]] = (),
) -> Drive:
    """Drive along a road, slower where it bends, at bumps and before halts.

    Args:
        road: The route.
        from_m: Path length at the start.
        across_m: Offset to its left, metres.
        cruise_m_per_s: Speed where nothing slows it.
        seconds: Duration.
        slow: (path length, speed) of places to pass slowly.
        halts: (path length, seconds) of places to wait at.
    """
    along = np.arange(from_m, from_m + (seconds + 1.0) * cruise_m_per_s + 1.0, _ROAD_STEP_M)
    _, _, heading = road.place(along, np.zeros_like(along))
    curvature = np.abs(np.gradient(heading, _ROAD_STEP_M))
    most = np.minimum(cruise_m_per_s, np.sqrt(_SIDEWAYS_M_PER_S2 / np.maximum(curvature, 1e-6)))
    for at, speed in slow:
        most[np.abs(along - at) < 1.5] = np.minimum(most[np.abs(along - at) < 1.5], speed)
    wait = np.zeros_like(along)
    for at, rest_s in halts:
        if along[0] <= at <= along[-1]:
            k = int(np.searchsorted(along, at))
            most[k], wait[k] = _WALKING_M_PER_S, rest_s
    square = most**2
    gain = 2 * _BRAKING_M_PER_S2 * _ROAD_STEP_M
    for k in range(len(square) - 2, -1, -1):
        square[k] = min(square[k], square[k + 1] + gain)
    for k in range(1, len(square)):
        square[k] = min(square[k], square[k - 1] + gain)
    speed = np.sqrt(square)
    spent = np.concatenate([[0.0], 2 * _ROAD_STEP_M / (speed[1:] + speed[:-1])]) + wait
    reached = np.cumsum(spent)
    left = np.stack([reached - wait, reached], axis=1).ravel()
    time = np.arange(0.0, seconds + 1.0, TIME_STEP_S)
    where = np.interp(time, left, np.repeat(along, 2))
    x, y, yaw = road.place(where, np.full_like(where, across_m))
    return Drive(time, x, y, yaw)


def drive_along(
    road: Road,
    *,
    from_m: float,
    across_m: float,
    speed: Knots,
    seconds: float,
    backwards: bool,
    reversing: bool = False,
) -> Drive:
    """Drive along a lane, against its road when `backwards`, in reverse gear when `reversing`."""
    time, travelled = _travel(speed, seconds)
    along = from_m + (-travelled if backwards else travelled)
    x, y, heading = road.place(along, np.full_like(along, across_m))
    return Drive(time, x, y, heading + (np.pi if backwards != reversing else 0.0))


def drive_across(
    road: Road, *, at_m: float, from_across_m: float, speed: Knots, seconds: float, leftwards: bool
) -> Drive:
    """Cross the road at right angles, towards its left or its right side."""
    time, travelled = _travel(speed, seconds)
    across = from_across_m + (travelled if leftwards else -travelled)
    x, y, heading = road.place(np.full_like(across, at_m), across)
    return Drive(time, x, y, heading + (np.pi / 2 if leftwards else -np.pi / 2))


def stand(road: Road, *, at_m: float, across_m: float, turned_rad: float = 0.0) -> Drive:
    """Return the drive of a standing object, such as a parked car."""
    x, y, heading = road.place(np.full(2, at_m), np.full(2, across_m))
    return Drive(np.array([0.0, 1.0]), x, y, heading + turned_rad)


def _travel(speed: Knots, seconds: float) -> tuple[Floats, Floats]:
    times, speeds = np.array(speed, dtype=np.float64).T
    time = np.arange(0.0, seconds + 1.0, TIME_STEP_S)
    now = np.interp(time, times, speeds)
    travelled = np.concatenate([[0.0], np.cumsum((now[1:] + now[:-1]) / 2 * TIME_STEP_S)])
    return time, travelled
