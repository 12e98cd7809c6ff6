"""Whether the two streams agree, point by point."""

from typing import cast

import numpy as np

from schemas.arrays import Agreements, Labels
from schemas.task import MOTION, Task


def compare(semantic: Labels, predictive: Labels, task: Task = MOTION) -> Agreements:
    """Say, for every point, whether the two streams agree.

    For motion the outcomes are the four of the paper (arXiv 2407.14306, section III-C). Ours adds
    `not_compared`, since a stream that does not know must not be counted as saying static.

    Args:
        semantic: (N,) uint8 labels of the supervised stream.
        predictive: (N,) uint8 labels of the self-supervised stream.
        task: What both were asked.

    Returns:
        (N,) uint8 codes of the task's outcomes; `not_compared` wherever either said `unknown`.

    Raises:
        ValueError: If the two streams labelled a different number of points.
    """
    if semantic.shape != predictive.shape:
        raise ValueError(
            f"streams labelled different points: {len(semantic)} semantic, "
            f"{len(predictive)} predictive; a stage must never drop or reorder points"
        )
    unknown = (semantic >= task.unknown) | (predictive >= task.unknown)
    codes = predictive * np.uint8(len(task.classes)) + semantic
    return cast("Agreements", np.where(unknown, np.uint8(task.not_compared), codes))
