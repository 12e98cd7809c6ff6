"""Preprocessing of a frame: deskewing, ground removal, voxels, range image, pose."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform
from schemas.frame import LidarFrame
from schemas.labels import Blindness, FrameHealth
from workers.lidar.beam_image import range_image
from workers.lidar.beam_learner import BeamLearner
from workers.lidar.beam_table import MIN_RANGE_M, BeamTable
from workers.lidar.compensation import to_middle
from workers.lidar.deskew import Twist
from workers.lidar.enough_points import too_few_returns
from workers.lidar.ground import ground_mask
from workers.lidar.lidar_views import LidarView, LidarViews
from workers.lidar.sensor_height import estimate_sensor_height
from workers.points.point_kernels import judged_rows, moved_rows, returns_within, rows_about
from workers.points.se3 import inverse
from workers.points.voxels import Voxels, voxelize

MAX_RANGE_M: Final = 80.0
"""Range up to which points are labelled, metres.

Beyond it neighbouring beams are 0.6 m apart or more, and a car is a handful of points."""

MAX_HEIGHT_M: Final = 3.0
"""Height over the sensor up to which points are labelled, metres: above every lorry, for a sensor
on the roof of a car."""

FARTHEST_M: Final = 1000.0
"""Range beyond which a return is invalid, metres; no lidar of a car reaches it."""

MIN_PLACES: Final = 3
"""Cells of 1.5 m that a frame must fill to be compared; odometry needs more for a pose."""

_SENSOR_ORIGIN: Final = np.zeros(3, np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class PreprocessedFrame:
    """A preprocessed frame, in the form that comparisons need.

    Attributes:
        points_m: (M, 3) its valid points about the beams' origin, deskewed to the middle of the
            sweep where their times are known.
        valid_index: (M,) indices of these points in the frame.
        ground: (M,) points on the ground.
        judged_index: (J,) indices of the points to label: off the ground, in range, not too high.
        voxels: Voxels of those points, odom space.
        image: (R, C) range image of all valid points.
        odom_from_beams: (4, 4) pose of the origin of the beams.
        beams_from_odom: (4, 4) the inverse pose.
        views: What further lidars saw; `image` and beams are those of the main lidar alone.
    """

    points_m: Points
    valid_index: NDArray[np.int64]
    ground: Mask
    judged_index: NDArray[np.int64]
    voxels: Voxels
    image: NDArray[np.float32]
    odom_from_beams: Transform
    beams_from_odom: Transform
    views: tuple[LidarView, ...] = ()


class Preprocessor:
    """Preprocesses the frames of one car, and learns beams and height of its lidars from them.

    Ground, judged points and voxels are those of all lidars; each range image is that of one.
    """

    def __init__(self) -> None:
        self._beams = BeamLearner()
        self._views = LidarViews()
        self.sensor_height_m: float = 0.0

    @property
    def table(self) -> BeamTable | None:
        """Beams of the sensor, learned so far."""
        return self._beams.table

    def __call__(
        self, frame: LidarFrame, odom_from_sensor: Transform, velocity: Twist | None
    ) -> PreprocessedFrame | None:
        """Preprocess a frame.

        Args:
            frame: The frame.
            odom_from_sensor: (4, 4) pose in the middle of its sweep.
            velocity: Twist of the sensor per second, for deskewing; None when unknown.

        Returns:
            None when the frame has almost no point, or no beams that could be measured.
        """
        valid_index = _returns(frame)
        points_m = rows_about(frame.points_m, valid_index, _SENSOR_ORIGIN)
        if too_few_returns(points_m, places=MIN_PLACES):
            return None
        main = int(np.searchsorted(valid_index, frame.main_points))
        if self._beams.learn(points_m[:main], frame.ring[valid_index[:main]]):
            self.sensor_height_m = 0.0
        if self.table is None or len(self.table.tangents) == 0:
            return None
        points_m = to_middle(frame, points_m, valid_index, velocity, self.table.origin_m)
        views = self._views(frame, points_m, valid_index, odom_from_sensor)
        points_m = points_m - self.table.origin_m.astype(np.float32)
        if not self.sensor_height_m:
            self.sensor_height_m = estimate_sensor_height(points_m[:main])
        ground = ground_mask(points_m, sensor_height_m=self.sensor_height_m)

        judged_index = judged_rows(points_m, ground, MIN_RANGE_M, MAX_RANGE_M, MAX_HEIGHT_M)
        odom_from_beams = odom_from_sensor.copy()
        odom_from_beams[:3, 3] += odom_from_sensor[:3, :3] @ self.table.origin_m
        return PreprocessedFrame(
            points_m=points_m,
            valid_index=valid_index,
            ground=ground,
            judged_index=judged_index,
            voxels=voxelize(moved_rows(points_m, judged_index, odom_from_beams)),
            image=range_image(points_m[:main], self.table),
            odom_from_beams=odom_from_beams,
            beams_from_odom=inverse(odom_from_beams),
            views=views,
        )

    def problem(self, frame: LidarFrame) -> FrameHealth:
        """Return why no point of a frame can be labelled, as far as points and beams cause it."""
        index = _returns(frame)
        if len(index) == 0:
            what = f"none of {len(frame)} points is a return" if len(frame) else "no point"
            return FrameHealth(Blindness.NO_POINTS, what)
        little = too_few_returns(frame.points_m[index], places=MIN_PLACES)
        if little:
            return FrameHealth(Blindness.NO_POINTS, little)
        reason = self.table.reason if self.table is not None else ""
        return FrameHealth(Blindness.NO_BEAMS, f"beams cannot be trusted: {reason}")


def _returns(frame: LidarFrame) -> NDArray[np.int64]:
    """Select the points that are returns: valid, finite and within the reach of a lidar."""
    return returns_within(frame.points_m, frame.valid_mask, np.float32(FARTHEST_M))
