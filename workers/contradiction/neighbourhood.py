"""What else is claimed around an instance: a thing of its own, or the rim of an agreed one."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from schemas.arrays import Labels, Points
from schemas.labels import MotionLabel
from workers.contradiction.box_queries import answers_around

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
        said = answers_around(self.points_m, self.other, thing_m, np.float32(AROUND_M))
        total = int(said.sum())
        if not total:
            return 1.0, 0.0
        return int(said[MotionLabel.STATIC]) / total, int(said[MotionLabel.DYNAMIC]) / total
