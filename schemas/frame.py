"""Lidar frame: one revolution, its pose, and the labels of the model that ran on the car."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform, check_array, freeze
from schemas.boxes import RecordedBoxes
from schemas.camera import CameraCalibration

StampAt = Literal["start", "middle", "end"]
"""Instant of the revolution that a frame's stamp gives."""

Compensated = Literal["auto", "yes", "no"]
"""A cloud recorded without the motion of the car: known, excluded, or recognised by its points."""


@dataclass(frozen=True, slots=True)
class RecordedClass:
    """One class of the model that ran on the car (MCAP metadata record `counterpoint.classes`)."""

    name: str
    movable: bool
    moving: bool


@dataclass(frozen=True, slots=True, eq=False)
class RecordedLabels:
    """Labels of every point of one frame by the model that ran on the car."""

    class_id: NDArray[np.uint16]
    motion: NDArray[np.uint8] | None
    confidence: NDArray[np.float32] | None
    classes: Mapping[int, RecordedClass]

    def __post_init__(self) -> None:
        """Check every array once, and make it read-only."""
        n = len(self.class_id)
        check_array("class_id", self.class_id, shape=(n,), dtype=np.uint16)
        if self.motion is not None:
            check_array("motion", self.motion, shape=(n,), dtype=np.uint8)
        if self.confidence is not None:
            check_array("confidence", self.confidence, shape=(n,), dtype=np.float32)
        freeze(self.class_id, self.motion, self.confidence)


@dataclass(frozen=True, slots=True)
class RecordedMotion:
    """Recorded motion of the car: means over the interval since the frame before.

    Both values are magnitudes, so the axes of the recording do not matter.

    Attributes:
        speed_m_per_s: Speed of some reference point on the car, metres per second.
        turn_rad_per_s: Rate of turn about the vertical, radians per second.
    """

    speed_m_per_s: float
    turn_rad_per_s: float


@dataclass(frozen=True, slots=True)
class RecordedFix:
    """Place of the car that its log records, in a frame that drives share.

    Attributes:
        time_ns: By the clock of the lidar, nanoseconds since the Unix epoch.
        frame: `wgs84`, or the name of a frame in metres.
        at: Latitude and longitude, degrees; in another frame x and y, metres.
    """

    time_ns: int
    frame: str
    at: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class JoinedLidar:
    """One further lidar of the car, whose points follow those of the main lidar in a frame.

    Attributes:
        topic: Topic of its clouds.
        points: Number of its points in the frame; 0 where it has no cloud near the frame.
        stamp_ns: Stamp of its cloud, nanoseconds since the Unix epoch; 0 without a cloud.
        main_from_lidar: (4, 4) its sensor space to that of the main lidar: as mounted, and after
            the poses are known with the car's motion between the middles of both sweeps.
        has_point_time: Whether its cloud has a time per point.
    """

    topic: str
    points: int
    stamp_ns: int
    main_from_lidar: Transform
    has_point_time: bool = False

    def __post_init__(self) -> None:
        """Check the transform once, and make it read-only."""
        check_array("main_from_lidar", self.main_from_lidar, shape=(4, 4), dtype=np.float64)
        freeze(self.main_from_lidar)


@dataclass(frozen=True, slots=True, eq=False)
class LidarFrame:
    """The returns of one lidar revolution, in the sensor's space.

    Nothing is filtered here: point ``i`` of the message stays point ``i`` through every stage, so
    labels are plain arrays of the same length. In a joined frame the points of further lidars
    follow, one lidar after the other, each in the order of its message; `ring` counts the beams of
    each lidar for itself.

    Attributes:
        log_id: The recording this frame belongs to.
        stamp_ns: Nanoseconds since the Unix epoch; rises strictly within a continuous stretch.
        points_m: (N, 3) float32, x forward, y left, z up; zero where `valid_mask` is false.
        intensity: (N,) float32, 0 to 1; zero where the log has none.
        offset_ns: (N,) int32, time of each return relative to `stamp_ns`.
        ring: (N,) int16, beam index as recorded; -1 where the log has none.
        valid_mask: (N,) bool, false for NaN, infinite and zero returns.
        has_point_time: Whether `offset_ns` was recorded rather than left zero.
        stamp_at: Which instant of the revolution `stamp_ns` names.
        compensated: Whether the motion of the car was removed before the cloud was recorded.
        recorded: The labels of the model that ran on the car, where the log contains them.
        boxes: Boxes of that model, where it answers in boxes and this frame has an answer.
        camera: Camera whose field of view limits the comparison; None compares all points.
        moved: Recorded motion since the frame before; None where the log has none.
        fixes: Places of the car that were recorded since the frame before, at any time near it.
        joined: Further lidars whose points follow those of the main one, silent ones included.

    Raises:
        ValueError: If an array has the wrong shape or dtype, or lengths differ.
    """

    log_id: str
    stamp_ns: int
    points_m: Points
    intensity: NDArray[np.float32]
    offset_ns: NDArray[np.int32]
    ring: NDArray[np.int16]
    valid_mask: Mask
    has_point_time: bool = False
    stamp_at: StampAt = "start"
    compensated: Compensated = "auto"
    recorded: RecordedLabels | None = None
    boxes: RecordedBoxes | None = None
    camera: CameraCalibration | None = None
    moved: RecordedMotion | None = None
    fixes: tuple[RecordedFix, ...] = ()
    joined: tuple[JoinedLidar, ...] = ()

    def __post_init__(self) -> None:
        """Check every array once, and make it read-only."""
        n = len(self.points_m)
        check_array("points_m", self.points_m, shape=(None, 3), dtype=np.float32)
        check_array("intensity", self.intensity, shape=(n,), dtype=np.float32)
        check_array("offset_ns", self.offset_ns, shape=(n,), dtype=np.int32)
        check_array("ring", self.ring, shape=(n,), dtype=np.int16)
        check_array("valid_mask", self.valid_mask, shape=(n,), dtype=np.bool_)
        if self.recorded is not None and len(self.recorded.class_id) != n:
            raise ValueError(
                f"recorded labels must be ({n}), got ({len(self.recorded.class_id)}): "
                "one label for each point of the cloud"
            )
        if self.joined and not 0 <= self.main_points <= n:
            raise ValueError(f"the joined lidars claim more than the {n} points of the frame")
        freeze(self.points_m, self.intensity, self.offset_ns, self.ring, self.valid_mask)

    def __len__(self) -> int:
        """Count the points, invalid ones included."""
        return len(self.points_m)

    @property
    def main_points(self) -> int:
        """Number of points of the main lidar, which come first."""
        return len(self.points_m) - sum(each.points for each in self.joined)

    def points_of(self, number: int) -> slice:
        """Return the points of one further lidar, by its place in `joined`."""
        first = self.main_points + sum(each.points for each in self.joined[:number])
        return slice(first, first + self.joined[number].points)

    def main(self) -> "LidarFrame":
        """Return the frame of the main lidar alone; the same object where none is joined."""
        return self.part(slice(0, self.main_points)) if self.joined else self

    def part(self, points: slice | Mask) -> "LidarFrame":
        """Return some of the points, with their labels, as a frame without further lidars."""
        said = self.recorded
        if said is not None:
            said = RecordedLabels(
                class_id=said.class_id[points],
                motion=None if said.motion is None else said.motion[points],
                confidence=None if said.confidence is None else said.confidence[points],
                classes=said.classes,
            )
        return replace(
            self,
            points_m=self.points_m[points],
            intensity=self.intensity[points],
            offset_ns=self.offset_ns[points],
            ring=self.ring[points],
            valid_mask=self.valid_mask[points],
            recorded=said,
            joined=(),
        )


class OdometryState(StrEnum):
    """State of the odometry, which says if a pose can be trusted; worst last."""

    HEALTHY = "healthy"
    DEGRADED = "degraded"
    LOST = "lost"


@dataclass(frozen=True, slots=True, eq=False)
class PosedFrame:
    """A frame and its pose.

    Attributes:
        frame: The frame.
        odom_from_sensor: (4, 4) pose at the middle of the sweep; odom is the sensor space of the
            first frame of the shard.
        odometry: State of the odometry, which says if the pose can be trusted.
        static_residual_m: Median distance of static structure to the map after registration,
            metres; NaN on the first frame.
        reason: Cause of a state other than healthy; empty when it is healthy.
        jumped: True if the pose moved farther since the frame before than a car can.
        remark: Further note on how the pose was judged; may be empty.
    """

    frame: LidarFrame
    odom_from_sensor: Transform
    odometry: OdometryState = OdometryState.HEALTHY
    static_residual_m: float = field(default=float("nan"))
    reason: str = ""
    jumped: bool = False
    remark: str = ""

    def __post_init__(self) -> None:
        """Check the pose once, and make it read-only."""
        check_array("odom_from_sensor", self.odom_from_sensor, shape=(4, 4), dtype=np.float64)
        freeze(self.odom_from_sensor)
