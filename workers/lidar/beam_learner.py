"""Beam learning: a sensor's beams from its first frames, and again where later ones show more."""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.lidar.beam_table import BeamTable, estimate_beam_table

_RELEARN_RETURNS = 2
_MORE_BEAMS = 1.2
_RELEARN_FRAMES = 10
"""Frames tried for a trusted table, one second: later frames will not give one either."""


class BeamLearner:
    """The beams of one sensor, learned from its frames.

    They are learned again where a frame with more than twice the returns shows more beams. While
    they cannot be trusted, each frame of the first second is tried, because a log may begin with
    almost no returns, or behind a lorry.

    Attributes:
        table: The learned beams; None before the first frame.
    """

    def __init__(self) -> None:
        self.table: BeamTable | None = None
        self._learned_returns = 0
        self._tried = 0

    def learn(self, points_m: Points, ring: NDArray[np.int16]) -> bool:
        """Measure the beams where they are unknown, or a frame shows many more of them.

        Args:
            points_m: (N, 3) returns of a frame, in its own space, metres.
            ring: (N,) recorded beam of each; -1 where unknown.

        Returns:
            True if the table was replaced.
        """
        richer = len(points_m) > _RELEARN_RETURNS * self._learned_returns
        doubted = self.table is None or not self.table.trusted
        if not richer and not (doubted and self._tried < _RELEARN_FRAMES):
            return False
        self._tried += 1
        self._learned_returns = len(points_m)
        table = estimate_beam_table(points_m, ring)
        known = 0 if self.table is None or doubted else len(self.table.tangents)
        if known and not (table.trusted and len(table.tangents) > _MORE_BEAMS * known):
            return False
        self.table = table
        return True
