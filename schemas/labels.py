"""Labels of one stream for the points of a frame, and the agreements of two streams."""

from dataclasses import dataclass
from enum import IntEnum, StrEnum

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Confidences, Labels, Mask, check_array, freeze


class MotionLabel(IntEnum):
    """Labels of the task `MOTION`. UNKNOWN is a label too: points are never dropped."""

    STATIC = 0
    DYNAMIC = 1
    UNKNOWN = 2


class Agreement(IntEnum):
    """Agreements of the task `MOTION`. They do not identify the stream that is right."""

    BOTH_STATIC = 0b00
    ONLY_SEMANTIC_DYNAMIC = 0b01
    ONLY_PREDICTIVE_DYNAMIC = 0b10
    BOTH_DYNAMIC = 0b11
    NOT_COMPARED = 0b100


class Blindness(StrEnum):
    """Causes for which a stream labelled nothing above the ground in a frame.

    NO_POINTS: the frame has no returns.
    NO_BEAMS: the beams could not be measured, so free space is unknown.
    NO_POSE: the odometry is lost.
    NO_PAST: no earlier frame to compare with, at the start and after a gap.
    NO_FIT: the frame does not fit those before it, so its pose, its time or theirs is wrong.
    """

    NO_POINTS = "no_points"
    NO_BEAMS = "no_beams"
    NO_POSE = "no_pose"
    NO_PAST = "no_past"
    NO_FIT = "no_fit"


@dataclass(frozen=True, slots=True)
class FrameHealth:
    """Input quality of a stream in one frame.

    Attributes:
        blindness: Cause for which it labelled nothing above the ground; None where it did.
        reason: The same as a sentence; empty where it labelled.
        seen_share: Share of the points to label that lie where an earlier frame saw a surface or
            free space; NaN without such points.
        answered: False where the model under test gave no answer for the frame.
    """

    blindness: Blindness | None = None
    reason: str = ""
    seen_share: float = float("nan")
    answered: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class FrameLabels:
    """Labels of one stream for every point of one frame.

    Attributes:
        labels: (N,) labels of the stream's task.
        confidence: (N,) 0 to 1, confidence of the stream in that label; 0 where UNKNOWN.
        class_id: (N,) semantic class as an index into the stream's `class_names`, -1 none; None
            from a stream without classes.
        ground_mask: (N,) true on the ground; None from a stream that does not detect it.
        cluster: (N,) index into `cluster_velocity_m_per_s`, -1 none; None without clusters.
        cluster_velocity_m_per_s: (K, 3) velocity of each cluster over the ground, odom space.
        confirmed: (N,) true where dynamic and confirmed more than once, enough to raise an alarm;
            None from a stream that confirms nothing.
        health: Input quality of the stream in this frame.

    Raises:
        ValueError: If lengths differ or an array has the wrong type.
    """

    labels: Labels
    confidence: Confidences
    class_id: NDArray[np.int16] | None = None
    ground_mask: Mask | None = None
    cluster: NDArray[np.int32] | None = None
    cluster_velocity_m_per_s: NDArray[np.float32] | None = None
    confirmed: Mask | None = None
    health: FrameHealth = FrameHealth()

    def __post_init__(self) -> None:
        """Check every array once, and make it read-only."""
        n = len(self.labels)
        check_array("labels", self.labels, shape=(n,), dtype=np.uint8)
        check_array("confidence", self.confidence, shape=(n,), dtype=np.float16)
        if self.class_id is not None:
            check_array("class_id", self.class_id, shape=(n,), dtype=np.int16)
        if self.ground_mask is not None:
            check_array("ground_mask", self.ground_mask, shape=(n,), dtype=np.bool_)
        if self.cluster is not None:
            check_array("cluster", self.cluster, shape=(n,), dtype=np.int32)
        if self.cluster_velocity_m_per_s is not None:
            check_array(
                "cluster_velocity_m_per_s",
                self.cluster_velocity_m_per_s,
                shape=(None, 3),
                dtype=np.float32,
            )
        if self.confirmed is not None:
            check_array("confirmed", self.confirmed, shape=(n,), dtype=np.bool_)
        freeze(
            self.labels,
            self.confidence,
            self.class_id,
            self.ground_mask,
            self.cluster,
            self.cluster_velocity_m_per_s,
            self.confirmed,
        )
