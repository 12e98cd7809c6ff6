"""What one frame is turned into before anything moves: ground, range image, voxels, pose."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform
from schemas.frame import LidarFrame
from workers.geometry.se3 import inverse, transform
from workers.selfsupervised.beam_table import MIN_RANGE_M, BeamTable, estimate_beam_table
from workers.selfsupervised.deskew import Twist, deskew, time_from_middle_s
from workers.selfsupervised.ground import estimate_sensor_height, ground_mask
from workers.selfsupervised.range_image import range_image
from workers.selfsupervised.voxels import Voxels, voxelize

MAX_RANGE_M: Final = 80.0
"""Beyond it neighbouring beams are 0.6 m apart or more, and a car is a handful of points."""

MAX_HEIGHT_M: Final = 3.0
"""Over the sensor: the highest lorry ends below it wherever the sensor is on a car's roof."""


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """One frame, ready to be compared with others.

    Attributes:
        points_m: (M, 3) its valid points about the beams' origin, brought to the middle of the
            sweep where their times are known.
        valid_index: (M,) which points of the frame they are.
        ground: (M,) which of them lie on the ground.
        judged_index: (J,) which of them take part: off the ground, in range, not too high.
        voxels: Of the judged points, odom space.
        image: (R, C) range image of all of them.
        odom_from_beams: (4, 4) where the beams met.
        beams_from_odom: (4, 4) the same, turned round.
    """

    points_m: Points
    valid_index: NDArray[np.int64]
    ground: Mask
    judged_index: NDArray[np.int64]
    voxels: Voxels
    image: NDArray[np.float32]
    odom_from_beams: Transform
    beams_from_odom: Transform


class Preparation:
    """Prepares the frames of one sensor; learns its beams and its height from the first."""

    def __init__(self) -> None:
        self.table: BeamTable | None = None
        self.sensor_height_m: float = 0.0

    def __call__(
        self, frame: LidarFrame, odom_from_sensor: Transform, velocity: Twist | None
    ) -> Prepared | None:
        """Prepare a frame.

        Args:
            frame: The frame.
            odom_from_sensor: (4, 4) pose in the middle of its sweep.
            velocity: Twist of the sensor per second, to undo the motion within the sweep; None
                when it is not known.

        Returns:
            None when the frame says nothing: no valid point, or no beams that could be measured.
        """
        valid_index = np.flatnonzero(frame.valid_mask)
        points_m = frame.points_m[valid_index]
        if self.table is None and len(points_m):
            table = estimate_beam_table(points_m, frame.ring[valid_index])
            self.table = table if len(table.tangents) else None
        if self.table is None or len(points_m) == 0:
            return None
        time_s = time_from_middle_s(frame)
        if velocity is not None and time_s is not None:
            points_m = deskew(points_m, time_s[valid_index], velocity)
        points_m = points_m - self.table.origin_m.astype(np.float32)
        if self.sensor_height_m == 0.0:
            self.sensor_height_m = estimate_sensor_height(points_m)
        ground = ground_mask(points_m, sensor_height_m=self.sensor_height_m)

        range_m = np.hypot(points_m[:, 0], points_m[:, 1])
        judged_index = np.flatnonzero(
            ~ground
            & (range_m > MIN_RANGE_M)
            & (range_m < MAX_RANGE_M)
            & (points_m[:, 2] < MAX_HEIGHT_M)
        )
        odom_from_beams = odom_from_sensor.copy()
        odom_from_beams[:3, 3] += odom_from_sensor[:3, :3] @ self.table.origin_m
        return Prepared(
            points_m=points_m,
            valid_index=valid_index,
            ground=ground,
            judged_index=judged_index,
            voxels=voxelize(transform(odom_from_beams, points_m[judged_index])),
            image=range_image(points_m, self.table),
            odom_from_beams=odom_from_beams,
            beams_from_odom=inverse(odom_from_beams),
        )
