"""Overlays of tests: labels for given agreements, and bytes of version 1."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Agreements
from schemas.overlay import Overlay, labels_from_agreements
from schemas.task import MOTION, Task
from schemas.transport.array_pack import pack
from schemas.transport.overlay_blocks import to_planes
from schemas.transport.overlay_version_1 import VERSION_1_MAGIC

IN_VERSION_1 = (
    "stamps_ns",
    "offsets",
    "agreements",
    "class_id",
    "semantic_confidence",
    "predictive_confidence",
    "odom_from_sensor",
    "instance_frame",
    "instance_kind",
    "instance_track",
    "instance_boxes",
)
"""Arrays that version 1 has as they are."""


def labels_of_points(agreements: Agreements, task: Task = MOTION) -> dict[str, Any]:
    """The labels of an overlay whose points have these agreements, without a witness."""
    semantic, predictive = labels_from_agreements(agreements, task)
    return {
        "semantic_labels": semantic,
        "predictive_labels": predictive,
        "witness_labels": np.full(len(agreements), task.unknown, dtype=np.uint8),
    }


def encode_version_1(overlay: Overlay) -> bytes:
    """The overlay as the program wrote it before frames were blocks of their own."""
    arrays: dict[str, NDArray[Any]] = {name: getattr(overlay, name) for name in IN_VERSION_1}
    arrays["points_cm"] = to_planes(overlay.points_cm)
    arrays["ground_mask"] = np.packbits(overlay.ground_mask)
    at = np.flatnonzero(overlay.instance_index >= 0)
    arrays["instance_index"] = overlay.instance_index[at]
    arrays["instance_points"] = at
    meta: dict[str, Any] = {
        "scene_id": overlay.scene_id,
        "class_names": list(overlay.class_names),
    }
    if overlay.task is not MOTION:
        meta["task"] = overlay.task.name
    return pack(VERSION_1_MAGIC, meta, arrays)
