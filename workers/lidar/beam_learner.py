"""Learns the beams of a sensor from its first frames, and anew where later ones show more."""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.lidar.beam_table import BeamTable, estimate_beam_table

_RELEARN_RETURNS = 2
_MORE_BEAMS = 1.2
_RELEARN_FRAMES = 10
"""A sensor whose beams could not be trusted in the first second will not be trusted later."""


class BeamLearner:
    """The beams of one sensor, as far as its frames have shown them.

    They are learned anew where a frame with more than twice the returns shows more beams, and,
    while they cannot be trusted, from each frame of the first second: a log may begin with next to
    nothing, or behind a lorry.

    Attributes:
        table: What is known of them; None before the first frame.
    """

    def __init__(self) -> None:
        self.table: BeamTable | None = None
        self._learned_returns = 0
        self._tried = 0

    def learn(self, points_m: Points, ring: NDArray[np.int16]) -> bool:
        """Measure the beams where they are not known, or a frame shows much more of them.

        Args:
            points_m: (N, 3) returns of a frame, in its own space, metres.
            ring: (N,) recorded beam of each; -1 where unknown.

        Returns:
            Whether the table is another one now.
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
