"""Whether the two streams agree, point by point."""

from typing import cast

import numpy as np

from schemas.arrays import Agreements, MotionLabels
from schemas.labels import Agreement, MotionLabel


def compare(semantic: MotionLabels, predictive: MotionLabels) -> Agreements:
    """Say, for every point, whether the two streams agree.

    The outcomes are the four of the paper (arXiv 2407.14306, section III-C); ours adds
    `NOT_COMPARED`, since a stream that does not know must not be counted as saying static.

    Args:
        semantic: (N,) uint8 `MotionLabel` of the supervised stream.
        predictive: (N,) uint8 `MotionLabel` of the self-supervised stream.

    Returns:
        (N,) uint8 `Agreement`; `NOT_COMPARED` wherever either stream said `UNKNOWN`.

    Raises:
        ValueError: If the two streams labelled a different number of points.
    """
    if semantic.shape != predictive.shape:
        raise ValueError(
            f"streams labelled different points: {len(semantic)} semantic, "
            f"{len(predictive)} predictive; a stage must never drop or reorder points"
        )
    unknown = (semantic == MotionLabel.UNKNOWN) | (predictive == MotionLabel.UNKNOWN)
    bits = semantic | (predictive << np.uint8(1))
    return cast("Agreements", np.where(unknown, np.uint8(Agreement.NOT_COMPARED), bits))
