"""Semantic motion labels as the published code writes them: class ids that also tell motion."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask

KITTI360_MOVABLE: Final = (24, 25, 26, 27, 28, 29, 30, 31, 32, 33, 43)
"""Person, rider, car, truck, bus, caravan, trailer, train, motorcycle, bicycle, other vehicle."""

FIRST_DYNAMIC: Final = 200
MOVING_CLASS: Final = 2
SEMANTIC_KITTI_STATIC: Final = 9
SEMANTIC_KITTI_MOVING: Final = 251
SEMANTIC_KITTI_FIXED: Final = 40
"""Classes from here on cannot move by themselves."""


def semantic_motion_labels(
    semantic: NDArray[np.integer], motion: NDArray[np.integer]
) -> NDArray[np.int16]:
    """Write both answers as the published code does: one class id that also tells motion.

    Args:
        semantic: (N,) class ids of KITTI-360 (Cityscapes).
        motion: (N,) classes of LMNet: 0 none, 1 static, 2 moving.

    Returns:
        (N,) int16: 200 to 210 for a movable class that moves, in the order of `KITTI360_MOVABLE`;
        else the class.
    """
    fused = semantic.astype(np.int16)
    for place, class_id in enumerate(KITTI360_MOVABLE):
        fused[(semantic == class_id) & (motion == MOVING_CLASS)] = FIRST_DYNAMIC + place
    return fused


def is_dynamic_label(semantic_motion: NDArray[np.integer]) -> Mask:
    """Say which semantic motion labels are dynamic; what is unlabelled counts as static."""
    last = FIRST_DYNAMIC + len(KITTI360_MOVABLE)
    dynamic: Mask = (semantic_motion >= FIRST_DYNAMIC) & (semantic_motion < last)
    return dynamic


def semantic_kitti_motion(
    semantic: NDArray[np.integer], motion: NDArray[np.integer]
) -> NDArray[np.uint32]:
    """Write both answers as LiDAR-MOS does for SemanticKITTI: moving, or not.

    Args:
        semantic: (N,) raw labels, the class in the lower 16 bits.
        motion: (N,) raw labels, 251 where moving.

    Returns:
        (N,) uint32: 251 for a movable class (1 to 39) that moves, else 9.
    """
    class_id, moves = semantic & 0xFFFF, (motion & 0xFFFF) == SEMANTIC_KITTI_MOVING
    movable = (class_id > 0) & (class_id < SEMANTIC_KITTI_FIXED)
    return np.where(
        movable & moves, np.uint32(SEMANTIC_KITTI_MOVING), np.uint32(SEMANTIC_KITTI_STATIC)
    )
