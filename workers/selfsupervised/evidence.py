"""What free space says about the voxels of a frame: the witness that motions are held against."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Transform
from workers.free_space import Votes
from workers.lidar.beam_table import BeamTable


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What free space says about every voxel of a frame.

    Attributes:
        votes: Of the frames of the last second.
        after: Of the frames after it, where it waited for them; no votes otherwise.
        near: (N,) answers of the near reference frame alone.
        far: (N,) answers of the far reference frame alone.
        image: Range image of the frame itself.
        table: Beams of the sensor.
        sensor_height_m: Of the origin of the beams over the road.
        beams_from_odom: (4, 4) pose of the frame, turned round.
    """

    votes: Votes
    after: Votes
    near: NDArray[np.int8]
    far: NDArray[np.int8]
    image: NDArray[np.float32]
    table: BeamTable
    sensor_height_m: float
    beams_from_odom: Transform

    @property
    def seen_through(self) -> Mask:
        """(N,) places that were free before, or are free after."""
        return self.votes.seen_through | self.after.seen_through
