"""Neighbourhood of an instance: labels that separate an object from the rim of an agreed one."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from schemas.arrays import Labels, Points
from schemas.labels import MotionLabel
from workers.contradiction.box_queries import labels_around

AROUND_M: Final = 1.0
"""Margin around an instance, metres: a rim lies within it, and other road users seldom do."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelledPoints:
    """All points off the ground of a frame with the label of the contradicting source.

    For motion this label is dynamic.

    Attributes:
        points_m: (M, 3) points, sensor space.
        other: (M,) their labels of the other stream.
    """

    points_m: Points
    other: Labels

    def label_shares(self, thing_m: Points) -> tuple[float, float]:
        """Return the refuted and the agreed share of these points in and around an object's box.

        The other stream labels a refuted point static and an agreed one dynamic.

        Args:
            thing_m: (N, 3) points of the object, which are among these points.
        """
        counts = labels_around(self.points_m, self.other, thing_m, np.float32(AROUND_M))
        total = int(counts.sum())
        if not total:
            return 1.0, 0.0
        return int(counts[MotionLabel.STATIC]) / total, int(counts[MotionLabel.DYNAMIC]) / total
