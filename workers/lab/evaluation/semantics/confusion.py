"""Intersection over union from a confusion matrix, per class and for a group of classes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask

_DIGITS = 4


def class_iou(confusion: NDArray[np.int64], names: Sequence[str]) -> dict[str, float]:
    """Return the intersection over union of each class that occurs in truth; class 0 is none.

    Args:
        confusion: (K, K) counts, rows are truth, columns predictions.
        names: Names of the classes.
    """
    hits = confusion.diagonal()
    union = confusion.sum(axis=0) + confusion.sum(axis=1) - hits
    return {
        name: round(float(hits[index] / union[index]), _DIGITS)
        for index, name in enumerate(names)
        if index and confusion[index].any()
    }


def joint_iou(confusion: NDArray[np.int64], chosen: Mask) -> float | None:
    """Return the IoU of a group of classes merged into one; None where none of them occurs.

    Args:
        confusion: (K, K) counts, rows are truth, columns predictions.
        chosen: (K,) classes of the group.
    """
    both = int(confusion[np.ix_(chosen, chosen)].sum())
    either = int(confusion[chosen].sum() + confusion[:, chosen].sum()) - both
    return round(both / either, _DIGITS) if either else None
