"""Fit of recorded boxes to the returns: boxes of another space cut through what stands there.

A detector's box holds its object, and little stands around it. Of the true boxes of a real street
80 % hold four times what lies around them; of boxes that are mirrored, turned, halved, lifted by
1.7 m, or whose length and width are exchanged, 3 to 15 % do.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

NEAR_M: Final = 30.0
"""Distance within which boxes are judged, metres: farther objects have few returns."""

FACE_M: Final = 0.1
AROUND_M: Final = 0.6
"""Returns up to `FACE_M` outside a box are its own, up to `AROUND_M` they are around it, metres."""

GROUND_M: Final = 0.3
"""Height above the lower face from which on returns are counted, metres: below is the ground."""

FEWEST_RETURNS: Final = 10
"""Returns in and around a box, from which on it is judged."""

HOLDS: Final = 4.0
"""Returns in a box for each one around it, from which on it holds its object."""

JUDGED_BOXES: Final = 40
"""Boxes of a shard after which the verdict stands."""

FEWEST_THAT_HOLD: Final = 0.35
"""Share of them that hold their object, below which the boxes are doubted."""

DOUBT: Final = (
    "most boxes of your model cut through what stands there: check their frame, axes and sides, "
    "and that x, y, z is the centre of a box"
)


class BoxFit:
    """Judges the boxes of one shard by its first frames."""

    def __init__(self) -> None:
        """Begin without a box."""
        self._judged = self._holding = 0

    @property
    def doubt(self) -> str:
        """Return why the boxes are doubted; empty while they are not."""
        enough = self._judged >= JUDGED_BOXES
        return DOUBT if enough and self._holding < FEWEST_THAT_HOLD * self._judged else ""

    def add(
        self,
        points_m: NDArray[np.float32],
        centre_m: NDArray[np.float64],
        space_from_box: NDArray[np.float64],
        half_m: NDArray[np.float64],
    ) -> None:
        """Judge the boxes of a frame, unless enough are judged.

        Args:
            points_m: (N, 3) points.
            centre_m: (B, 3) centres in the same space.
            space_from_box: (B, 3, 3) their rotations.
            half_m: (B, 3) half their sides.
        """
        near = np.flatnonzero(np.linalg.norm(centre_m[:, :2], axis=1) < NEAR_M)
        for box in near.tolist():
            if self._judged >= JUDGED_BOXES:
                return
            inside, around = _returns(points_m, centre_m[box], space_from_box[box], half_m[box])
            if inside + around >= FEWEST_RETURNS:
                self._judged += 1
                self._holding += inside > HOLDS * around


def _returns(
    points_m: NDArray[np.float32],
    centre_m: NDArray[np.float64],
    space_from_box: NDArray[np.float64],
    half_m: NDArray[np.float64],
) -> tuple[int, int]:
    """Count the returns in a box and around it."""
    reach_m = float(np.linalg.norm(half_m + AROUND_M))
    close = points_m[(np.abs(points_m - centre_m) < reach_m).all(axis=1)]
    in_box = (close - centre_m) @ space_from_box
    low, high = GROUND_M - half_m[2], half_m[2] + FACE_M
    beside = np.abs(in_box[:, :2])[(in_box[:, 2] > low) & (in_box[:, 2] < high)]
    inside = int((beside < half_m[:2] + FACE_M).all(axis=1).sum())
    return inside, int((beside < half_m[:2] + AROUND_M).all(axis=1).sum()) - inside
