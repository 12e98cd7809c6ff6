"""The paper's metrics in every published variant: mIoU, AP, AR and F1 of contradictions.

Source: arXiv 2407.14306, section IV and its code. A contradiction on an anomaly is a hit. The names
differ from their usual meaning: mIoU is a mean over frames, not over classes; AP and AR are means
of precision and recall; F1 is computed from these two means.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.lab.lidarcoda.matching import COLUMNS
from workers.lidar.fidelity import Form


class PointSet(StrEnum):
    """Points that count.

    ALL: those of the method and those inside the boxes. BOXES: those inside the boxes. OVERLAP:
    those inside the boxes that the method labelled.
    """

    ALL = "All"
    BOXES = "Boxes"
    OVERLAP = "Overlap"


class Averaging(StrEnum):
    """INDIVIDUAL: each frame or annotation by itself. AGGREGATED: all points together."""

    INDIVIDUAL = "individual"
    AGGREGATED = "aggregated"


@dataclass(frozen=True, slots=True)
class Measures:
    """The measures of one variant.

    Attributes:
        n: Frames or annotations that have points in the set.
        mean_iou: Mean of TP / (TP + FP + FN).
        average_precision: Mean of TP / (TP + FP).
        average_recall: Mean of TP / (TP + FN).
        f1: Harmonic mean of the two means.
        ratios: Mean shares of TP, FP, FN and TN in the set.
    """

    n: int
    mean_iou: float
    average_precision: float
    average_recall: float
    f1: float
    ratios: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class _Confusion:
    """(N,) counts of each row, and the number of points in its set."""

    tp: NDArray[np.int64]
    fp: NDArray[np.int64]
    fn: NDArray[np.int64]
    tn: NDArray[np.int64]
    size: NDArray[np.int64]


_PLACE: Final[Mapping[str, int]] = {name: place for place, name in enumerate(COLUMNS)}


def paper_measures(
    counts: NDArray[np.int64],
    points: PointSet,
    *,
    clustered: bool,
    averaging: Averaging,
    form: Form = Form.CORRECTED,
) -> Measures:
    """Compute the metrics of one variant.

    The corrected form differs from the published code in this:

    - a frame in which a measure has no denominator is left out of its mean (published: it counts as
      0, and frames without an anomaly lower recall);
    - without clustering, points inside boxes without a category are no misses in the overlap, which
      excludes them (published: they are, and shares sum to more than 1).

    Args:
        counts: (N, 21) counts in the order of `COLUMNS`, a row for each frame or annotation.
        points: Points that count; `ALL` has no meaning for annotations.
        clustered: Whether only the points of the object are the anomaly; else all in its box.
        averaging: Each row by itself, or all points together.
        form: Corrected or published form.

    Returns:
        The measures; all zero where no row has points in the set.
    """
    if averaging is Averaging.AGGREGATED:
        counts = counts.sum(axis=0, keepdims=True)
    found = _confusion(counts, points, clustered=clustered, form=form)
    used = found.size > 0
    tp, fp, fn, tn, size = (
        each[used].astype(np.float64)
        for each in (found.tp, found.fp, found.fn, found.tn, found.size)
    )
    if not len(size):
        return Measures(0, 0.0, 0.0, 0.0, 0.0, (0.0, 0.0, 0.0, 0.0))
    precision, recall = _mean(tp, tp + fp, form), _mean(tp, tp + fn, form)
    both = precision + recall
    return Measures(
        n=len(size),
        mean_iou=_mean(tp, tp + fp + fn, form),
        average_precision=precision,
        average_recall=recall,
        f1=2 * precision * recall / both if both else 0.0,
        ratios=(
            float((tp / size).mean()),
            float((fp / size).mean()),
            float((fn / size).mean()),
            float((tn / size).mean()),
        ),
    )


def _mean(part: NDArray[np.float64], whole: NDArray[np.float64], form: Form) -> float:
    """Return the mean ratio of the rows; a row without denominator counts as 0, or is left out."""
    ratio = np.divide(part, whole, out=np.zeros_like(part), where=whole > 0)
    if form is Form.CORRECTED:
        ratio = ratio[whole > 0]
    return float(ratio.mean()) if len(ratio) else 0.0


def _confusion(
    counts: NDArray[np.int64], points: PointSet, *, clustered: bool, form: Form
) -> _Confusion:
    def of(*names: str) -> NDArray[np.int64]:
        total: NDArray[np.int64] = counts[:, [_PLACE[name] for name in names]].sum(axis=1)
        return total

    on, on_missed, on_unseen = of("c13", "c14"), of("c11", "c12"), of("c10")
    beside, beside_missed, beside_unseen = of("c-13", "c-14"), of("c-11", "c-12"), of("c-10")
    labelled = on + on_missed + beside + beside_missed
    overlap, unseen = points is PointSet.OVERLAP, on_unseen + beside_unseen
    size = labelled if overlap else labelled + unseen
    if clustered:
        tp, fp, fn, tn = on, beside, on_missed, beside_missed
        if not overlap:
            fn, tn = fn + on_unseen, tn + beside_unseen
    else:
        tp, fn = on + beside, on_missed + beside_missed
        fp, tn = np.zeros_like(tp), np.zeros_like(tp)
        if not overlap or form is Form.PAPER:
            fn = fn + unseen
    if points is PointSet.ALL:
        fp, tn = fp + of("c3", "c4"), tn + of("c1", "c2")
        size = size + of("c1", "c2", "c3", "c4")
    return _Confusion(tp, fp, fn, tn, size)
