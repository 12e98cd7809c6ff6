"""Overlays of tests: labels for given agreements."""

from typing import Any

import numpy as np

from schemas.arrays import Agreements
from schemas.overlay import labels_from_agreements
from schemas.task import MOTION, Task


def labels_of_points(agreements: Agreements, task: Task = MOTION) -> dict[str, Any]:
    """The labels of an overlay whose points have these agreements, without a witness."""
    semantic, predictive = labels_from_agreements(agreements, task)
    return {
        "semantic_labels": semantic,
        "predictive_labels": predictive,
        "witness_labels": np.full(len(agreements), task.unknown, dtype=np.uint8),
    }
