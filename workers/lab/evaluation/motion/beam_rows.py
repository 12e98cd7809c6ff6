"""Beam rows: the beam of each point in order of elevation, so that beams can be removed."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from schemas.frame import LidarFrame
from workers.errors import LogUnusableError

MIN_BEAM_POINTS: Final = 20
"""Points needed to measure the elevation of a beam."""

_MIN_BEAMS: Final = 4
_MAX_BEAMS: Final = 512
_TURN_RAD: Final = np.pi
"""Fall of the azimuth that begins a new beam in clouds stored beam by beam, radians."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamRows:
    """The beams of a sensor in order of rising elevation, measured on its first frame.

    Beams come from the recorded ring of each point. Where no ring is recorded, they come from the
    order of the points, if the cloud is stored beam by beam (as those of KITTI are).

    Attributes:
        tangents: (R,) tangent of each row's elevation, rising.
        row_of_ring: (B,) row of each recorded beam, -1 none; empty where none is recorded.
    """

    tangents: NDArray[np.float64]
    row_of_ring: NDArray[np.int64]

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.tangents)

    @classmethod
    def of(cls, frame: LidarFrame) -> Self:
        """Measure the beams of a frame.

        Raises:
            LogUnusableError: If neither recorded rings nor the order of the points identify beams.
        """
        recorded = bool((frame.ring[frame.valid_mask] >= 0).any())
        beams = frame.ring.astype(np.int64) if recorded else _in_turns(frame)
        tangents = _tangents(frame, beams)
        known = np.flatnonzero(np.isfinite(tangents))
        if not _MIN_BEAMS <= len(known) <= _MAX_BEAMS:
            raise LogUnusableError(
                f"cannot leave out beams of {frame.log_id}: its points have no ring, and are not "
                "in the order of beams"
            )
        order = known[np.argsort(tangents[known], kind="stable")]
        row_of_ring = np.full(len(tangents) if recorded else 0, -1)
        if recorded:
            row_of_ring[order] = np.arange(len(order))
        return cls(tangents[order], row_of_ring)

    def rows_of(self, frame: LidarFrame) -> NDArray[np.int64]:
        """Return the row of each point of a frame, (N,); -1 none."""
        if len(self.row_of_ring):
            ring = np.clip(frame.ring, 0, len(self.row_of_ring) - 1)
            inside = (frame.ring >= 0) & (frame.ring < len(self.row_of_ring))
            return np.where(inside, self.row_of_ring[ring], -1)
        beams = _in_turns(frame)
        tangents = _tangents(frame, beams)
        known = np.flatnonzero(np.isfinite(tangents))
        row_of_beam = np.full(len(tangents), -1)
        if len(known) == len(self):
            row_of_beam[known[np.argsort(tangents[known], kind="stable")]] = np.arange(len(self))
        else:
            away = np.abs(tangents[known, None] - self.tangents)
            row_of_beam[known] = away.argmin(axis=1)
        return row_of_beam[beams]


def _in_turns(frame: LidarFrame) -> NDArray[np.int64]:
    """(N,) number of azimuth turns before each point."""
    x, y = frame.points_m[:, 0].astype(np.float64), frame.points_m[:, 1].astype(np.float64)
    azimuth = np.mod(np.arctan2(y, x), 2 * np.pi)
    falls = np.abs(np.diff(azimuth, prepend=azimuth[:1])) > _TURN_RAD
    return np.cumsum(falls)


def _tangents(frame: LidarFrame, beams: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the median tangent of elevation of each beam; NaN with too few points."""
    points = frame.points_m.astype(np.float64)
    tangent = points[:, 2] / np.maximum(np.hypot(points[:, 0], points[:, 1]), 0.1)
    usable = np.flatnonzero(frame.valid_mask & (beams >= 0))
    count = int(beams.max(initial=-1)) + 1
    order = usable[np.lexsort((tangent[usable], beams[usable]))]
    start = np.searchsorted(beams[order], np.arange(count + 1))
    medians = np.full(count, np.nan)
    enough = np.diff(start) >= MIN_BEAM_POINTS
    medians[enough] = tangent[order][((start[:-1] + start[1:]) // 2)[enough]]
    return medians
