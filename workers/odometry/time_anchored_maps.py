"""Time-anchored maps: poses over a second are the same wherever a log was cut.

A pose of KISS-ICP depends on every frame in its map. Two maps that begin at different frames differ
by millimetres for as long as the sensor is near. A new map therefore begins with the first frame of
every two seconds of the clock. It is built for a second next to the one in use, which it then
replaces. A pass that begins in the middle of a log has the same maps as all others at most three
seconds later (five where a rounded speed differs).
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
"""Time for which a map is built before its use, nanoseconds.

After half a second it is used too early (recall .978 instead of .980); a map of a single frame lags
by 0.17 m behind a car that sets off."""

FOUND_STEP_M: Final = 1.0
"""Largest error of the first step from an estimated speed, metres.

A map that follows another one has KISS-ICP's own 2 m; with 1 m false clusters are .09 and .11 per
frame instead of .065."""

_ROUNDED: Final = np.array([0.01, 0.01, 0.01, 0.1, 0.1, 0.1])
"""Rounding of the first twist of a map, rad/s and m/s.

Two odometries differ by less, so they mostly begin a map with the same twist. 0.5 m/s is too coarse
(false clusters .15 instead of .065)."""


class TimeAnchoredMaps:
    """The map in use and, half of the time, the one that follows it."""

    def __init__(self, odom_from_first: Transform, velocity: Twist | None) -> None:
        """Begin a stretch.

        Args:
            odom_from_first: (4, 4) pose of its first frame.
            velocity: Twist of the sensor per second; None if unknown.
        """
        self._map = KissMap(None) if velocity is None else KissMap(velocity, step_m=FOUND_STEP_M)
        self._odom_from_map = odom_from_first
        self._next: KissMap | None = None
        self._next_ns = 0
        self._stamp_ns: int | None = None

    def expected(self, stamp_ns: int) -> Transform:
        """Predict the pose (4, 4) at constant velocity."""
        return self._odom_from_map @ self._map.expected(self._dt_s(stamp_ns))

    def register(
        self, points: Points, stamp_ns: int, velocity: Twist | None
    ) -> tuple[Transform | None, NDArray[np.float64]]:
        """Register a frame; no map changes until `accept`.

        Args:
            points: (N, 3) of the frame, about the sensor.
            stamp_ns: Its time.
            velocity: Last twist of the sensor per second; None if unknown.

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

    def accept(self) -> None:
        """Add the last registered frame to the maps."""
        self._map.accept()
        if self._next is not None:
            self._next.accept()

    def continue_from(self, pose: Transform, stamp_ns: int) -> None:
        """Continue from a pose in odom space that no registration found."""
        moved = inverse(self._odom_from_map @ self._map.pose) @ pose
        self._map.continue_from(self._map.pose @ moved)
        if self._next is not None:
            self._next.continue_from(self._next.pose @ moved)
        self._stamp_ns = stamp_ns

    def _dt_s(self, stamp_ns: int) -> float:
        return 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) / NS_PER_S


def _rounded(velocity: Twist | None) -> Twist | None:
    return None if velocity is None else np.round(velocity / _ROUNDED) * _ROUNDED
