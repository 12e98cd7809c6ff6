"""Bent sweeps: frames that could not be deskewed although the car drives.

The first frame of a stretch has no earlier pose, so that its motion is unknown when it is prepared.
At 15 m/s its sweep is bent by 0.7 m at either end. Half a second later it would be the reference of
another frame, in which road and parked cars then seem to move. The next frame shows the motion.
"""

from typing import Final

import numpy as np

from schemas.frame import LidarFrame
from workers.lidar.deskew import Twist, time_from_middle_s

BENT_M: Final = 0.1
"""Least displacement of a point within half a sweep that bends it, metres.

It is a quarter of the margin of free space. A car that drives at 2 m/s reaches it."""

_LEVER_M: Final = 10.0
"""Range at which the turn of the sensor displaces a point, metres."""

_REMEMBERED: Final = 4


class BentSweeps:
    """Finds the frames without deskewing that the next frame shows to be bent."""

    def __init__(self) -> None:
        self._before: LidarFrame | None = None
        self._bent_ns: list[int] = []

    def found(self, frame: LidarFrame, velocity: Twist | None) -> int | None:
        """Return the stamp of the frame before, if it is bent; None otherwise.

        Args:
            frame: The frame that arrives.
            velocity: (6,) twist of the sensor per second, by which it is deskewed; None if unknown.
        """
        before, self._before = self._before, frame if velocity is None else None
        if before is None or velocity is None:
            return None
        time_s = time_from_middle_s(before)
        if time_s is None:
            return None  # no frame of such a log is deskewed: all are bent alike
        half_s = float(np.abs(time_s[before.valid_mask]).max(initial=0.0))
        m_per_s = float(np.linalg.norm(velocity[3:]))
        m_per_s += _LEVER_M * float(np.linalg.norm(velocity[:3]))
        if m_per_s * half_s < BENT_M:
            return None
        self._bent_ns = [*self._bent_ns, before.stamp_ns][-_REMEMBERED:]
        return before.stamp_ns

    def was_bent(self, stamp_ns: int) -> bool:
        """Return whether the frame of this stamp was found to be bent."""
        return stamp_ns in self._bent_ns
