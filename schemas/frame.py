"""One lidar revolution, where it was taken, and what the car's own model said about it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform, check_array, freeze
from schemas.camera import CameraCalibration

StampAt = Literal["start", "middle", "end"]
"""Which instant of the revolution a frame's stamp names."""


@dataclass(frozen=True, slots=True)
class RecordedClass:
    """One class of the model that ran on the car (MCAP metadata record `counterpoint.classes`)."""

    name: str
    movable: bool
    moving: bool


@dataclass(frozen=True, slots=True, eq=False)
class RecordedLabels:
    """What the model that ran on the car said about every point of one frame.

    Attributes:
        class_id: (N,) the model's own class ids.
        motion: (N,) 0 unknown, 1 static, 2 dynamic, as recorded; None when only classes are.
        confidence: (N,) 0 to 1; None when not recorded.
        classes: Class id to its meaning.
    """

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
    """What the log itself says of how the car moved, in the mean since the frame before.

    Whatever the axes of who recorded it: both are magnitudes.

    Attributes:
        speed_m_per_s: Of a place on the car.
        turn_rad_per_s: About the vertical.
    """

    speed_m_per_s: float
    turn_rad_per_s: float


@dataclass(frozen=True, slots=True, eq=False)
class LidarFrame:
    """The returns of one lidar revolution, in the sensor's space.

    Nothing is filtered here: point ``i`` of the message stays point ``i`` through every stage, so
    labels are plain arrays of the same length.

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
        recorded: The labels of the model that ran on the car, where the log holds them.
        camera: The camera whose view is compared, where one is wanted.
        moved: What the log says of the motion since the frame before, where it does.

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
    recorded: RecordedLabels | None = None
    camera: CameraCalibration | None = None
    moved: RecordedMotion | None = None

    def __post_init__(self) -> None:
        """Check every array once, and make it read-only for the rest of its life."""
        n = len(self.points_m)
        check_array("points_m", self.points_m, shape=(None, 3), dtype=np.float32)
        check_array("intensity", self.intensity, shape=(n,), dtype=np.float32)
        check_array("offset_ns", self.offset_ns, shape=(n,), dtype=np.int32)
        check_array("ring", self.ring, shape=(n,), dtype=np.int16)
        check_array("valid_mask", self.valid_mask, shape=(n,), dtype=np.bool_)
        if self.recorded is not None and len(self.recorded.class_id) != n:
            raise ValueError(
                f"recorded labels must be ({n}), got ({len(self.recorded.class_id)}): "
                "a label for each point of the cloud"
            )
        freeze(self.points_m, self.intensity, self.offset_ns, self.ring, self.valid_mask)

    def __len__(self) -> int:
        """Count the points, invalid ones included."""
        return len(self.points_m)


class OdometryState(StrEnum):
    """Whether a pose may be trusted; worst last."""

    HEALTHY = "healthy"
    DEGRADED = "degraded"
    LOST = "lost"


@dataclass(frozen=True, slots=True, eq=False)
class PosedFrame:
    """A frame and where the sensor was.

    Attributes:
        frame: The frame.
        odom_from_sensor: (4, 4) pose at the middle of the sweep; odom is the sensor space of the
            first frame of the shard.
        odometry: Whether that pose may be trusted.
        static_residual_m: Median distance of static structure to the map after registration,
            metres; NaN on the first frame.
        reason: Why the pose is not healthy; empty when it is.
        jumped: Whether it went where no car goes from one frame to the next.
        remark: What else a reader should know of how it was judged; empty for nothing.
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
