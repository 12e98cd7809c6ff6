"""Nearest points of two frames in odom space, which change with no label and can be kept."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from schemas.arrays import Mask
from schemas.contradiction import LabelledFrame

FLICKER_M: Final = 0.3
"""Distance within which the nearest point of the other frame is the same place, metres."""

Index = NDArray[np.int32]


@dataclass(slots=True, eq=False)
class NearestPoints:
    """Finds the nearest points of another frame; a drive of many variants keeps what it found.

    Attributes:
        keeps: Whether answers are kept, for frames that differ in supervised labels alone.
    """

    keeps: bool = False
    _found: dict[tuple[int, int], tuple[Mask, Mask, Index]] = field(default_factory=dict)

    def of(
        self, frame: LabelledFrame, valid: Mask, other: LabelledFrame, others: Mask, asked: Mask
    ) -> Index:
        """Return the rows of the nearest points of `other`, of the asked points that have one.

        Args:
            frame: The frame.
            valid: (N,) points of it that can be asked for.
            other: Another frame of the same odom space.
            others: (M,) points of it that can be nearest.
            asked: (N,) points to find the nearest of, all of them valid.
        """
        if not self.keeps:
            found = _nearest(frame, asked, other, others)
            return found[found >= 0]
        key = frame.stamp_ns, other.stamp_ns
        kept = self._found.get(key)
        if kept is None or not (np.array_equal(kept[0], valid) and np.array_equal(kept[1], others)):
            rows = np.full(len(valid), -1, np.int32)
            rows[valid] = _nearest(frame, valid, other, others)
            kept = self._found[key] = valid, others, rows
        found = kept[2][asked]
        return found[found >= 0]


def _nearest(frame: LabelledFrame, asked: Mask, other: LabelledFrame, others: Mask) -> Index:
    """Return for each asked point the row of the nearest one of `others`, -1 none."""
    rows = np.flatnonzero(others)
    if not asked.any() or not len(rows):
        return np.full(int(asked.sum()), -1, np.int32)
    tree = cKDTree(_in_odom(other, others), balanced_tree=False, compact_nodes=False)
    _, nearest = tree.query(_in_odom(frame, asked), distance_upper_bound=FLICKER_M)
    found: Index = np.append(rows, -1).astype(np.int32)[nearest]
    return found


def _in_odom(frame: LabelledFrame, wanted: Mask) -> NDArray[np.float64]:
    pose = frame.posed.odom_from_sensor
    return frame.posed.frame.points_m[wanted] @ pose[:3, :3].T + pose[:3, 3]
