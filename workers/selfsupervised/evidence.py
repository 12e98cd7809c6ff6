"""Free-space evidence on the voxels of a frame, against which motions are verified."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Transform
from workers.free_space import Votes
from workers.lidar.beam_table import BeamTable
from workers.lidar.lidar_views import LidarView


@dataclass(frozen=True, slots=True, eq=False)
class FreeSpaceEvidence:
    """Free-space evidence on every voxel of a frame.

    Attributes:
        votes: Votes of the frames of the last second.
        after: Votes of the frames after it, where the stream waited for them; empty otherwise.
        near: (N,) visibility codes from the near reference frame alone.
        far: (N,) visibility codes from the far reference frame alone.
        image: Range image of the frame itself.
        table: Beams of the sensor.
        sensor_height_m: Height of the origin of the beams over the road.
        beams_from_odom: (4, 4) inverse pose of the frame.
        views: What further lidars saw in the frame itself.
    """

    votes: Votes
    after: Votes
    near: NDArray[np.int8]
    far: NDArray[np.int8]
    image: NDArray[np.float32]
    table: BeamTable
    sensor_height_m: float
    beams_from_odom: Transform
    views: tuple[LidarView, ...] = ()

    @property
    def seen_through(self) -> Mask:
        """(N,) voxels whose place was free before, or is free afterwards."""
        return self.votes.seen_through | self.after.seen_through
