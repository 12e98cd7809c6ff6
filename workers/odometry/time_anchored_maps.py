"""Maps that begin by the clock: poses over a second are the same wherever a log was cut.

What KISS-ICP answers hangs on all that its map ever took in; two that began at different frames
differ by millimetres for as long as the sensor is near. So a new map begins with the first frame of
every two seconds of the clock, is built beside the one in use for a second, and then takes over.
Whoever comes to a log in the middle has, three seconds later at most, the maps of all others (five
where a rounded speed differs).
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Points, Transform
from workers.lidar.deskew import Twist
from workers.odometry.kiss_map import KissMap
from workers.points.se3 import inverse

EVERY_NS: Final = 2 * NS_PER_S
LEAD_NS: Final = NS_PER_S
"""A map of half a second is used too early (recall .978 for .980), one of a single frame lags by
0.17 m behind a car that sets off."""

FOUND_STEP_M: Final = 1.0
"""How far the first step may be off from a speed that was looked for. A map that follows another
one has KISS-ICP's own 2 m; with 1 m false clusters are .09 and .11 a frame, for .065."""

_ROUNDED: Final = np.array([0.01, 0.01, 0.01, 0.1, 0.1, 0.1])
"""Radians and metres per second, so that two odometries, which differ by less, mostly begin a map
alike; 0.5 m/s is too much to begin with (false clusters .065 to .15)."""


class MapsByClock:
    """The map in use and, half of the time, the one that follows it."""

    def __init__(self, odom_from_first: Transform, velocity: Twist | None) -> None:
        """Begin a stretch.

        Args:
            odom_from_first: (4, 4) pose of its first frame.
            velocity: How the sensor moves, per second; None if that is not known.
        """
        self._map = KissMap(None) if velocity is None else KissMap(velocity, step_m=FOUND_STEP_M)
        self._odom_from_map = odom_from_first
        self._next: KissMap | None = None
        self._next_ns = 0
        self._stamp_ns: int | None = None

    def expected(self, stamp_ns: int) -> Transform:
        """(4, 4) where the sensor would be, had it gone on as it went."""
        return self._odom_from_map @ self._map.expected(self._dt_s(stamp_ns))

    def register(
        self, points: Points, stamp_ns: int, velocity: Twist | None
    ) -> tuple[Transform | None, NDArray[np.float64]]:
        """Register a frame; it is in no map until they are told to take it in.

        Args:
            points: (N, 3) of the frame, about the sensor.
            stamp_ns: Its time.
            velocity: How the sensor moved last, per second; None if that is not known.

        Returns:
            (4, 4) its pose in odom space, None if registration failed; and (K, 3) its key points.
        """
        dt_s, before_ns = self._dt_s(stamp_ns), self._stamp_ns
        self._stamp_ns = stamp_ns
        if self._next is not None and stamp_ns - self._next_ns >= LEAD_NS:
            self._odom_from_map = self._odom_from_map @ self._map.pose @ inverse(self._next.pose)
            self._map, self._next = self._next, None
        pose, keypoints = self._map.register(points, dt_s)
        if self._next is not None:
            if self._next.register(points, dt_s)[0] is None:
                self._next = None
        elif before_ns is not None and before_ns // EVERY_NS != stamp_ns // EVERY_NS:
            self._next, self._next_ns = KissMap(_rounded(velocity)), stamp_ns
            self._next.register(points, dt_s)
        return (None if pose is None else self._odom_from_map @ pose), keypoints

    def take_in(self) -> None:
        """Lay the frame that was registered last into the maps."""
        self._map.take_in()
        if self._next is not None:
            self._next.take_in()

    def believe(self, pose: Transform, stamp_ns: int) -> None:
        """Go on from a pose in odom space that no registration gave."""
        moved = inverse(self._odom_from_map @ self._map.pose) @ pose
        self._map.believe(self._map.pose @ moved)
        if self._next is not None:
            self._next.believe(self._next.pose @ moved)
        self._stamp_ns = stamp_ns

    def _dt_s(self, stamp_ns: int) -> float:
        return 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) / NS_PER_S


def _rounded(velocity: Twist | None) -> Twist | None:
    return None if velocity is None else np.round(velocity / _ROUNDED) * _ROUNDED
