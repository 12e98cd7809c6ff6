"""Observation: the range image of a frame for votes, and its places to be voted on."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Mask, Transform
from schemas.contradiction import LabelledFrame
from schemas.frame import OdometryState, PosedFrame
from schemas.labels import MotionLabel
from workers.lidar.beam_image import range_image
from workers.lidar.beam_learner import BeamLearner
from workers.lidar.beam_table import MIN_RANGE_M, BeamTable
from workers.lidar.compensation import to_middle
from workers.lidar.deskew import Twist, twist
from workers.lidar.lidar_views import LidarView, LidarViews
from workers.points.point_kernels import judged_rows, moved_rows, returns_within, rows_about
from workers.points.se3 import inverse, transform
from workers.points.voxels import Voxels, voxelize
from workers.witness.pose_repair import PoseCheck
from workers.witness.recorded_motion import MotionCheck, MotionComparison

MAX_RANGE_M: Final = 80.0
"""Range up to which places are labelled, metres.

Beyond it neighbouring beams are 0.6 m apart or more, and a car is a handful of points."""

MAX_HEIGHT_M: Final = 3.0
"""Height over the sensor up to which places are labelled, metres: above every lorry, for a sensor
on the roof of a car."""

PLACE_M: Final = 0.2
"""Voxel size, metres; finer than the margins of free space (0.4 m), so a place represents its
points."""

MAX_GAP_NS: Final = NS_PER_S // 2
"""Longest gap between frames of one stretch, nanoseconds."""

_FARTHEST: Final = np.float32(1000.0)
_FEWEST_RETURNS: Final = 100
_SENSOR_ORIGIN: Final = np.zeros(3, np.float32)
_FASTEST_M_PER_S: Final = 70.0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The range image of a frame and its places to be labelled.

    Attributes:
        image: (R, C) its range image.
        table: The beams of that image.
        beams_from_odom: (4, 4) inverse pose of the origin of the beams.
        judged_index: (J,) indices of the points to label: off the ground, within range.
        places: Their voxels, odom space.
        further: What further lidars saw; image, table and pose are those of the main one.
    """

    image: NDArray[np.float32]
    table: BeamTable
    beams_from_odom: Transform
    judged_index: NDArray[np.int64]
    places: Voxels
    further: tuple[LidarView, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """One frame in the witness's memory.

    Attributes:
        stamp_ns: Its time.
        stretch: Number of its stretch of consistent poses; only frames of one stretch vote.
        view: Its range image and places; None where it cannot vote.
        problem: Reason to doubt its pose; empty where there is none.
        remark: Reason not to believe the recorded motion; empty where it is believed.
    """

    stamp_ns: int
    stretch: int
    view: View | None = None
    problem: str = ""
    remark: str = ""


class Observer:
    """Builds the observations of a shard; keeps the beams, the last pose and the stretch."""

    def __init__(self) -> None:
        self._beams = BeamLearner()
        self._views = LidarViews()
        self._poses = PoseCheck()
        self._recorded = MotionCheck()
        self._correction: Transform = np.eye(4)
        self._last: PosedFrame | None = None
        self._stretch = 0

    def __call__(
        self, labelled: LabelledFrame, following: LabelledFrame | None = None
    ) -> Observation:
        """Return the observation of one frame.

        Args:
            labelled: The frame.
            following: The frame after it. The first frame of a stretch has no earlier pose, and is
                deskewed by the step to this one: at 15 m/s its sweep is bent by 0.7 m.
        """
        velocity, verdict = self._follow(labelled.posed)
        if velocity is None and following is not None:
            velocity = _velocity_to(labelled.posed, following.posed)
        observation = self._observe(labelled, velocity)
        if verdict.problem and not observation.problem:
            # the frame has no known place: later frames are consistent with none before it
            self._begin_stretch()
            observation = replace(observation, stretch=self._stretch, problem=verdict.problem)
        return replace(observation, remark=verdict.remark) if verdict.remark else observation

    def _observe(self, labelled: LabelledFrame, velocity: Twist | None) -> Observation:
        posed = labelled.posed
        frame = posed.frame
        index = returns_within(frame.points_m, frame.valid_mask, _FARTHEST)
        if len(index) < _FEWEST_RETURNS or posed.odometry is OdometryState.LOST:
            return Observation(frame.stamp_ns, self._stretch)
        points_m = rows_about(frame.points_m, index, _SENSOR_ORIGIN)
        main = int(np.searchsorted(index, frame.main_points))
        if self._beams.learn(points_m[:main], frame.ring[index[:main]]):
            self._begin_stretch()
        table = self._beams.table
        if table is None or not table.trusted or not len(table.tangents):
            return Observation(frame.stamp_ns, self._stretch)
        points_m = to_middle(frame, points_m, index, velocity, table.origin_m)
        from_sensor_m = points_m
        points_m = points_m - table.origin_m.astype(np.float32)
        odom_from_beams = self._correction @ posed.odom_from_sensor
        odom_from_beams[:3, 3] += odom_from_beams[:3, :3] @ table.origin_m
        judged = judged_rows(
            points_m, _ground(labelled, index), MIN_RANGE_M, MAX_RANGE_M, MAX_HEIGHT_M
        )
        places = voxelize(moved_rows(points_m, judged, odom_from_beams), voxel_m=PLACE_M)
        still_m = places.centroids_m[~_moving(labelled, index[judged], places)]
        fit = self._poses.judge(still_m, odom_from_beams, frame.stamp_ns)
        if fit.correction is not None:
            self._correction = fit.correction @ self._correction
            odom_from_beams = fit.correction @ odom_from_beams
            places = Voxels(transform(fit.correction, places.centroids_m), places.of_point)
        odom_from_sensor = self._correction @ posed.odom_from_sensor
        view = View(
            image=range_image(points_m[:main], table),
            table=table,
            beams_from_odom=inverse(odom_from_beams),
            judged_index=index[judged],
            places=places,
            further=self._views(frame, from_sensor_m, index, odom_from_sensor),
        )
        return Observation(frame.stamp_ns, self._stretch, view, fit.problem)

    def _follow(self, posed: PosedFrame) -> tuple[Twist | None, MotionComparison]:
        """Begin a new stretch where poses are not consistent, else estimate the sensor's motion.

        Returns:
            Its twist per second, None if unknown, and the comparison with the recorded motion.
        """
        last, self._last = self._last, posed
        if last is None:
            return None, MotionComparison()
        step_ns = posed.frame.stamp_ns - last.frame.stamp_ns
        lost = OdometryState.LOST in (posed.odometry, last.odometry)
        if not 0 < step_ns <= MAX_GAP_NS or lost:
            self._begin_stretch()
            return None, MotionComparison()
        velocity = _velocity(last, posed)
        verdict = self._recorded.judge(velocity, posed.frame.moved, step_ns / NS_PER_S)
        return (None if _is_impossible(velocity) or posed.jumped else velocity), verdict

    def _begin_stretch(self) -> None:
        self._stretch += 1
        self._poses.clear()


def _velocity(before: PosedFrame, after: PosedFrame) -> Twist:
    """Return the twist of the sensor per second, from one frame to a later one."""
    step_ns = after.frame.stamp_ns - before.frame.stamp_ns
    moved = twist(inverse(before.odom_from_sensor) @ after.odom_from_sensor)
    velocity: Twist = moved * (NS_PER_S / step_ns)
    return velocity


def _is_impossible(velocity: Twist) -> bool:
    return float(np.linalg.norm(velocity[3:])) > _FASTEST_M_PER_S


def _velocity_to(posed: PosedFrame, following: PosedFrame) -> Twist | None:
    """Return the sensor's motion by the next step; None where the poses are not consistent."""
    step_ns = following.frame.stamp_ns - posed.frame.stamp_ns
    lost = OdometryState.LOST in (posed.odometry, following.odometry)
    if not 0 < step_ns <= MAX_GAP_NS or lost or posed.jumped or following.jumped:
        return None
    velocity = _velocity(posed, following)
    return None if _is_impossible(velocity) else velocity


def _ground(labelled: LabelledFrame, index: NDArray[np.int64]) -> Mask:
    ground_mask = labelled.predictive.ground_mask
    return np.zeros(len(index), np.bool_) if ground_mask is None else ground_mask[index]


def _moving(labelled: LabelledFrame, index: NDArray[np.int64], places: Voxels) -> Mask:
    """Return (V,) places in which either stream labels a point dynamic."""
    dynamic = labelled.semantic.labels[index] == MotionLabel.DYNAMIC
    dynamic |= labelled.predictive.labels[index] == MotionLabel.DYNAMIC
    moving = np.zeros(len(places.centroids_m), np.bool_)
    if labelled.task.moving:
        moving[places.of_point[dynamic]] = True
    return moving
