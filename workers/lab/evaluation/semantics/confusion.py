"""What a confusion of classes says: intersection over union, class by class and taken together."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask

_DIGITS = 4


def class_iou(confusion: NDArray[np.int64], names: Sequence[str]) -> dict[str, float]:
    """Intersection over union of each class that truth has; class 0 is none.

    Args:
        confusion: (K, K) counts, rows are truth, columns answers.
        names: Of the classes.
    """
    hits = confusion.diagonal()
    union = confusion.sum(axis=0) + confusion.sum(axis=1) - hits
    return {
        name: round(float(hits[index] / union[index]), _DIGITS)
        for index, name in enumerate(names)
        if index and confusion[index].any()
    }


def joint_iou(confusion: NDArray[np.int64], chosen: Mask) -> float | None:
    """Intersection over union of some classes taken for one; None where none of them occurs.

    Args:
        confusion: (K, K) counts, rows are truth, columns answers.
        chosen: (K,) which classes.
    """
    both = int(confusion[np.ix_(chosen, chosen)].sum())
    either = int(confusion[chosen].sum() + confusion[:, chosen].sum()) - both
    return round(both / either, _DIGITS) if either else None
