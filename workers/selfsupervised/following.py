"""Whether a frame follows the one before it: later frames are asked only as far as poses go on."""

from typing import Final

import numpy as np

from schemas.arrays import NS_PER_S, Points
from workers.selfsupervised.fit import FitMonitor
from workers.selfsupervised.history import PastFrame
from workers.selfsupervised.registration import reference_to

LONGEST_S: Final = 0.45
"""Between two frames; after longer gaps too little of a street is still in sight to compare."""


class Following:
    """Compares each frame with the one before it, as it comes."""

    def __init__(self) -> None:
        self._fit = FitMonitor()
        self._last: PastFrame | None = None

    def follows(self, frame: PastFrame, points_m: Points, *, anew: bool) -> bool:
        """Say whether a frame fits the one before it, so that both may be asked of one place.

        Args:
            frame: The frame.
            points_m: (V, 3) its voxel centroids off the ground, odom space.
            anew: Whether it is not compared with any before it.
        """
        last, self._last = self._last, frame
        if last is None or anew:
            return True
        age_s = (frame.stamp_ns - last.stamp_ns) / NS_PER_S
        if age_s > LONGEST_S:
            return False
        reference = reference_to(last.grid, last.odom_from_beams[:3, 3], age_s)
        known = np.ones(len(points_m), np.bool_)
        centre_m = frame.odom_from_beams[:3, 3]
        # one frame is asked, of what is known: of the far one nothing
        near, far = (reference, known), (reference, ~known)
        return not self._fit.problem(points_m, centre_m, near=near, far=far)
