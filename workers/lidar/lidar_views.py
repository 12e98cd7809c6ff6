"""Views of further lidars: the range image of each of them, from its own place and beams."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points, Transform
from schemas.frame import LidarFrame
from workers.lidar.beam_image import range_image
from workers.lidar.beam_learner import BeamLearner
from workers.lidar.beam_table import BeamTable
from workers.points.se3 import inverse, transform


@dataclass(frozen=True, slots=True, eq=False)
class LidarView:
    """View of one further lidar within one frame.

    Attributes:
        image: (R, C) its range image.
        table: Its beams.
        beams_from_odom: (4, 4) inverse pose of the origin of its beams, at the middle of its sweep.
    """

    image: NDArray[np.float32]
    table: BeamTable
    beams_from_odom: Transform

    def expressed_in(self, old_from_new: Transform) -> "LidarView":
        """Return the view for places in another space, given (4, 4) the old space from it."""
        return LidarView(self.image, self.table, self.beams_from_odom @ old_from_new)


class LidarViews:
    """Views of the further lidars of one car, whose beams it learns from their own clouds.

    A lidar whose beams cannot be trusted has no view: its points are places, and its rays prove
    nothing.
    """

    def __init__(self) -> None:
        self._beams: dict[int, BeamLearner] = {}

    def __call__(
        self,
        frame: LidarFrame,
        points_m: Points,
        index: NDArray[np.int64],
        odom_from_sensor: Transform,
    ) -> tuple[LidarView, ...]:
        """Return the views of a frame; none where a lidar is alone, silent or without beams.

        Args:
            frame: The frame.
            points_m: (M, 3) returns of all lidars, in the main lidar's space of the middle of its
                sweep.
            index: (M,) their places in the frame, rising.
            odom_from_sensor: (4, 4) pose of the main lidar.
        """
        views = []
        for number, lidar in enumerate(frame.joined):
            points = frame.points_of(number)
            first, last = np.searchsorted(index, [points.start, points.stop])
            own_m = transform(inverse(lidar.main_from_lidar), points_m[first:last])
            beams = self._beams.setdefault(number, BeamLearner())
            if len(own_m):
                beams.learn(own_m, frame.ring[index[first:last]])
            table = beams.table
            if not len(own_m) or table is None or not table.trusted or len(table.tangents) < 2:
                continue
            odom_from_beams = odom_from_sensor @ lidar.main_from_lidar
            odom_from_beams[:3, 3] += odom_from_beams[:3, :3] @ table.origin_m
            about_m = own_m - table.origin_m.astype(np.float32)
            views.append(LidarView(range_image(about_m, table), table, inverse(odom_from_beams)))
        return tuple(views)
