"""Fusion of both networks to semantic motion labels: what can move, and does, is dynamic."""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Confidences, Mask, MotionLabels
from schemas.labels import MotionLabel


def fuse(*, judged_mask: Mask, movable_mask: Mask, moving_mask: Mask | None) -> MotionLabels:
    """Combine semantics and motion, point by point.

    The paper's rule (section III-A): a point is dynamic if its class is movable and the motion
    network says that it moves; everything else that was judged is static. A house that "moves" is a
    slip of the motion network, not a dynamic house.

    Without a past frame the motion network cannot know. Then a movable point is UNKNOWN, while any
    other stays STATIC, because no answer of the motion network could have changed that.

    Args:
        judged_mask: (N,) points the networks saw.
        movable_mask: (N,) points of a class that can move by itself.
        moving_mask: (N,) points the motion network calls moving; None without a past frame.

    Returns:
        (N,) labels; UNKNOWN where not judged.
    """
    if moving_mask is None:
        moved = np.where(movable_mask, np.uint8(MotionLabel.UNKNOWN), np.uint8(MotionLabel.STATIC))
    else:
        moved = np.where(
            movable_mask & moving_mask, np.uint8(MotionLabel.DYNAMIC), np.uint8(MotionLabel.STATIC)
        )
    return np.where(judged_mask, moved, np.uint8(MotionLabel.UNKNOWN))


def confidence_of(labels: MotionLabels, dynamic_share: NDArray[np.float32]) -> Confidences:
    """Say how sure the fused stream is of each label.

    Args:
        labels: (N,) fused labels.
        dynamic_share: (N,) how likely each point is dynamic: the probability of a movable class
            times the probability of moving, 0 to 1.

    Returns:
        (N,) float16: that probability for DYNAMIC, its complement for STATIC, 0 for UNKNOWN.
    """
    sure = np.where(labels == MotionLabel.DYNAMIC, dynamic_share, 1 - dynamic_share)
    return np.where(labels == MotionLabel.UNKNOWN, 0, np.clip(sure, 0, 1)).astype(np.float16)
