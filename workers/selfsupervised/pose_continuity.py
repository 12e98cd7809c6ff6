"""Pose continuity: later frames vote only while consecutive poses fit each other."""

from collections import deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Points
from workers.selfsupervised.history import PastFrame, expected_m
from workers.selfsupervised.pose_consistency import PoseConsistency
from workers.selfsupervised.registration import reference_to

LONGEST_S: Final = 0.45
"""Longest gap between two frames, seconds; after it too little of a street is still in view."""


class PoseContinuity:
    """Compares each arriving frame with the one before it."""

    def __init__(self) -> None:
        self._fit = PoseConsistency()
        self._before: deque[PastFrame] = deque(maxlen=2)

    def follows(self, frame: PastFrame, points_m: Points, *, restarts: bool) -> bool:
        """Return True if a frame fits the one before it, so that both can vote on one place.

        Args:
            frame: The frame.
            points_m: (V, 3) its voxel centroids off the ground, odom space.
            restarts: The frame begins a stretch and is compared with none before it.
        """
        if restarts:
            self._before.clear()
        expressed = [each.expressed_in(frame.space) for each in self._before]
        expected = expected_m(expressed, frame.stamp_ns)
        last = expressed[-1] if expressed else None
        self._before.append(frame)
        return last is None or fits(self._fit, frame, points_m, last, expected_m=expected)


def fits(
    monitor: PoseConsistency,
    frame: PastFrame,
    points_m: Points,
    last: PastFrame,
    *,
    expected_m: NDArray[np.floating] | None = None,
) -> bool:
    """Return True if a frame fits an earlier one as well as frames of this log usually do.

    Args:
        monitor: Learned usual fit, updated.
        frame: The frame.
        points_m: (V, 3) its voxel centroids off the ground, odom space.
        last: The frame before it, in any space.
        expected_m: (3,) place of the sensor at constant velocity; None if unknown.
    """
    age_s = (frame.stamp_ns - last.stamp_ns) / NS_PER_S
    if age_s > LONGEST_S:
        return False
    centre_m, last = frame.odom_from_beams[:3, 3], last.expressed_in(frame.space)
    reference = reference_to(last.grid, last.odom_from_beams[:3, 3], age_s)
    known = np.ones(len(points_m), np.bool_)
    # one frame is asked, of what is known: of the far one nothing
    near, far = (reference, known), (reference, ~known)
    return not monitor.problem(points_m, centre_m, near=near, far=far, expected_m=expected_m)
