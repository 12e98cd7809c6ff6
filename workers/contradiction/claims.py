"""What else is claimed around an instance: a thing of its own, or the rim of an agreed one."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Labels, Points
from schemas.labels import MotionLabel

AROUND_M: Final = 1.0
"""Rims lie within a metre of what they are rims of, and other road users seldom do."""


@dataclass(frozen=True, slots=True, eq=False)
class Claims:
    """All points off the ground of which one voice says that they move.

    Attributes:
        points_m: (M, 3) where they are, sensor space.
        other: (M,) what the other stream says of them.
    """

    points_m: Points
    other: Labels

    def answered(self, thing_m: Points) -> tuple[float, float]:
        """Shares of the claims in and around the box of a thing that are denied, and agreed.

        Args:
            thing_m: (N, 3) points of the thing, which are claims themselves.
        """
        inside = np.ones(len(self.points_m), np.bool_)
        for axis in range(3):  # column by column: numpy is slow along an axis of three
            low, high = thing_m[:, axis].min() - AROUND_M, thing_m[:, axis].max() + AROUND_M
            inside &= (self.points_m[:, axis] >= low) & (self.points_m[:, axis] <= high)
        said: NDArray[np.uint8] = self.other[inside]
        if not len(said):
            return 1.0, 0.0
        denied, agreed = said == MotionLabel.STATIC, said == MotionLabel.DYNAMIC
        return float(denied.mean()), float(agreed.mean())
