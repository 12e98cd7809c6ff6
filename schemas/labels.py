"""What a stream says about a point, and what two streams say together."""

from dataclasses import dataclass
from enum import IntEnum, StrEnum

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Confidences, Labels, Mask, check_array, freeze


class MotionLabel(IntEnum):
    """The labels of the task `MOTION`. UNKNOWN is an answer: points are never dropped."""

    STATIC = 0
    DYNAMIC = 1
    UNKNOWN = 2


class Agreement(IntEnum):
    """The agreements of the task `MOTION`. They do not say which stream is right."""

    BOTH_STATIC = 0b00
    ONLY_SEMANTIC_DYNAMIC = 0b01
    ONLY_PREDICTIVE_DYNAMIC = 0b10
    BOTH_DYNAMIC = 0b11
    NOT_COMPARED = 0b100


class Blindness(StrEnum):
    """Why a stream judged nothing off the ground in a frame.

    NO_POINTS: nothing came back. NO_BEAMS: the beams could not be measured, so it cannot be told
    what was seen through. NO_POSE: the odometry is lost. NO_PAST: nothing to compare with yet, at
    the start and after a gap. NO_FIT: the frame does not fit those before it, so its pose, its
    time or theirs is wrong.
    """

    NO_POINTS = "no_points"
    NO_BEAMS = "no_beams"
    NO_POSE = "no_pose"
    NO_PAST = "no_past"
    NO_FIT = "no_fit"


@dataclass(frozen=True, slots=True)
class FrameHealth:
    """What a stream had to go by in one frame.

    Attributes:
        blindness: Why it judged nothing off the ground; None where it did.
        reason: The same in words; empty where it judged.
        seen_share: Share of what it was asked about that an earlier frame saw, or saw through; NaN
            where none was asked.
    """

    blindness: Blindness | None = None
    reason: str = ""
    seen_share: float = float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class FrameLabels:
    """What one stream says about every point of one frame.

    Attributes:
        labels: (N,) labels of the stream's task.
        confidence: (N,) 0 to 1, how sure the stream is of that label; 0 where UNKNOWN.
        class_id: (N,) semantic class as an index into the stream's `class_names`, -1 none; None
            from a stream that knows no classes.
        ground_mask: (N,) true on the ground; None from a stream that does not look for it.
        cluster: (N,) index into `cluster_velocity_m_per_s`, -1 none; None without clusters.
        cluster_velocity_m_per_s: (K, 3) velocity of each cluster over the ground, odom space.
        confirmed: (N,) dynamic, and proved more than once: what an alarm may be raised on; None
            from a stream that does not tell.
        health: What the stream had to go by.

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
