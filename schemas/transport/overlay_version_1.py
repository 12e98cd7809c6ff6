"""Reader of overlays of version 1: one pack of all frames, with agreements instead of labels."""

from typing import Any, Final

import numpy as np

from schemas.overlay import Overlay, labels_from_agreements
from schemas.task import MOTION, task_named
from schemas.transport.array_pack import unpack
from schemas.transport.overlay_blocks import from_planes

VERSION_1_MAGIC: Final = b"CPOVL1\n\0"
"""First bytes of an overlay of version 1."""


def decoded_version_1(payload: bytes) -> Overlay:
    """Decode an overlay of version 1.

    Where the streams were not compared both labels are `unknown`, since version 1 has the agreement
    alone. It has no label of the witness, no pictures and no inputs of the score.

    Raises:
        PackUnreadableError: If the bytes are damaged.
        KeyError, TypeError, ValueError, IndexError, UnknownTaskError: If they are no overlay.
    """
    meta, packed = unpack(VERSION_1_MAGIC, payload)
    arrays: dict[str, Any] = dict(packed)
    arrays["points_cm"] = from_planes(arrays["points_cm"])
    points = len(arrays["points_cm"])
    bits = np.unpackbits(arrays["ground_mask"], count=points)
    arrays["ground_mask"] = bits.view(np.bool_)
    index = np.full(points, -1, dtype=np.int32)
    index[arrays.pop("instance_points")] = arrays["instance_index"]
    arrays["instance_index"] = index
    task = task_named(str(meta.get("task", MOTION.name)))
    agreements = arrays.pop("agreements")
    if len(agreements) and int(agreements.max()) > task.not_compared:
        raise ValueError(f"agreements must lie in 0 to {task.not_compared}")
    semantic, predictive = labels_from_agreements(agreements, task)
    return Overlay(
        scene_id=str(meta["scene_id"]),
        class_names=tuple(str(name) for name in meta["class_names"]),
        task=task,
        semantic_labels=semantic,
        predictive_labels=predictive,
        witness_labels=np.full(points, task.unknown, dtype=np.uint8),
        **arrays,
    )
