"""Labels of points by recorded boxes: class, motion and confidence of the box that a point is in.

Outside every box the model answered that nothing is there: such a point counts as static, without a
class. Static structure does not contradict that, a proved mover does.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Transform
from schemas.boxes import RecordedBoxes
from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import FrameHealth, FrameLabels, MotionLabel
from workers.lidar.deskew import Twist, deskew, motion, time_from_middle_s, twist
from workers.points.points_in_boxes import points_in_boxes
from workers.points.se3 import inverse
from workers.supervised.box_fit import BoxFit
from workers.supervised.box_motion import BoxMotion

MARGIN_M: Final = 0.3
"""Error of the faces of detectors' boxes, metres: next to a box that may move, a point is neither
in it nor static."""

BOTTOM_M: Final = 0.2
"""Height above the lower face of a box in which the ground lies, metres; it moves in no box."""

MAX_CLASSES: Final = 1_000
"""Names of classes of one log; points in boxes of further classes have none."""

NO_MOTION: Final = "your model says no motion: parked or moving cannot be judged"

HALF_SWEEP_S: Final = 0.05
"""Half of a revolution at 10 Hz, seconds, where no point has a time of its own."""

_MAX_STEP_S: Final = 0.5


class BoxLabels:
    """Labels of the frames of one shard, in order.

    Args:
        classes: Index and name by name; names are added as they come.
    """

    def __init__(self, classes: dict[int | str, tuple[int, str]]) -> None:
        self._classes = classes
        self._motion = BoxMotion()
        self._fit = BoxFit()
        self._before: PosedFrame | None = None

    def label(self, posed: PosedFrame, boxes: RecordedBoxes) -> FrameLabels:
        """Label the points of a frame by its boxes."""
        frame = posed.frame
        velocity = self._twist(posed)
        middle_from_boxes, points_m, time_s = _aligned(frame, boxes, velocity)
        labels_of_box, velocity_m_per_s = self._motion.labels(
            boxes, posed.odom_from_sensor @ middle_from_boxes
        )
        turn = middle_from_boxes[:3, :3]
        centre_m = boxes.centre_m @ turn.T + middle_from_boxes[:3, 3]
        middle_from_box = np.ascontiguousarray(turn @ boxes.sensor_from_box)
        self._fit.add(points_m, centre_m, middle_from_box, boxes.size_m / 2)
        inside, near = points_in_boxes(
            points_m,
            time_s,
            centre_m,
            middle_from_box,
            boxes.size_m / 2,
            velocity_m_per_s @ turn.T,
            MARGIN_M,
            BOTTOM_M,
        )
        return self._labels(frame, boxes, labels_of_box, inside, near)

    def skip(self, posed: PosedFrame) -> None:
        """Note a frame without an answer, which has a pose all the same."""
        self._before = posed

    def _labels(
        self,
        frame: LidarFrame,
        boxes: RecordedBoxes,
        labels_of_box: NDArray[np.uint8],
        inside: NDArray[np.int32],
        near: NDArray[np.int32],
    ) -> FrameLabels:
        labels = np.full(len(frame), MotionLabel.STATIC, np.uint8)
        confidence = np.ones(len(frame), np.float16)
        class_id = np.full(len(frame), -1, np.int16)
        may_move = np.append(labels_of_box != MotionLabel.STATIC, False)
        labels[may_move[near]] = MotionLabel.UNKNOWN
        found = np.flatnonzero(inside >= 0)
        box = inside[found]
        labels[found] = labels_of_box[box]
        confidence[found] = np.nan_to_num(boxes.score, nan=1.0).astype(np.float16)[box]
        class_id[found] = np.array([self._class(name) for name in boxes.class_name], np.int16)[box]
        labels[~frame.valid_mask] = MotionLabel.UNKNOWN
        confidence[labels == MotionLabel.UNKNOWN] = 0
        return FrameLabels(
            labels=labels,
            confidence=confidence,
            class_id=class_id,
            health=FrameHealth(reason=self._fit.doubt if _says_motion(boxes) else NO_MOTION),
        )

    def _class(self, name: str) -> int:
        if not name or (name not in self._classes and len(self._classes) >= MAX_CLASSES):
            return -1
        return self._classes.setdefault(name, (len(self._classes), name))[0]

    def _twist(self, posed: PosedFrame) -> Twist:
        """Return the motion of the sensor per second since the frame before; zero without one."""
        before, self._before = self._before, posed
        if before is None or posed.jumped:
            return np.zeros(6)
        step_s = (posed.frame.stamp_ns - before.frame.stamp_ns) / NS_PER_S
        if not 0.0 < step_s <= _MAX_STEP_S:
            return np.zeros(6)
        return twist(inverse(before.odom_from_sensor) @ posed.odom_from_sensor) / step_s


def _says_motion(boxes: RecordedBoxes) -> bool:
    """Return whether an answer states the motion of any box that may move, or has none such."""
    stated = np.isfinite(boxes.velocity_m_per_s).all(axis=1)
    told = stated.any() or any(boxes.track_id) or any(boxes.moving)
    return bool(told) or all(movable is False for movable in boxes.movable)


def _aligned(
    frame: LidarFrame, boxes: RecordedBoxes, velocity: Twist
) -> tuple[Transform, NDArray[np.float32], NDArray[np.float32]]:
    """Bring points and boxes into one space: that of the sensor in the middle of the sweep.

    Boxes with the stamp of the cloud were found in it: they fit its points as recorded, so neither
    is moved. All others are of an instant, so the points are deskewed and have times of their own.

    Returns:
        (4, 4) middle from the boxes' sensor space, (N, 3) points, and (N,) their times after the
        boxes in seconds.
    """
    if boxes.stamp_ns == frame.stamp_ns:
        return np.eye(4), frame.points_m, np.zeros(len(frame), np.float32)
    since_middle = time_from_middle_s(frame)
    offset_s = {"start": HALF_SWEEP_S, "middle": 0.0, "end": -HALF_SWEEP_S}[frame.stamp_at]
    points_m = frame.points_m
    if since_middle is not None:
        offset_s = float(frame.offset_ns[0]) / NS_PER_S - float(since_middle[0])
        points_m = deskew(points_m, since_middle, velocity)
    after_boxes_s = (frame.stamp_ns - boxes.stamp_ns) / NS_PER_S + offset_s
    time_s = np.full(len(frame), after_boxes_s, np.float32)
    if since_middle is not None:
        time_s += since_middle
    return motion(velocity * -after_boxes_s), points_m, time_s
