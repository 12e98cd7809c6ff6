"""Point matching by coordinates: assigns true points to labelled points for the paper's metrics.

True points lie inside the 2D boxes of CODA's annotations and either belong to the object or not.
The method's points have one of the four categories. The two sets share no index.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.lidar.fidelity import Form

TOLERANCE_M: Final = 0.001
"""Matching tolerance per axis, metres: true points were rounded to a millimetre on writing."""

COLUMNS: Final = (
    *("c-11", "c-12", "c-13", "c-14", "c11", "c12", "c13", "c14", "c-10", "c10"),
    *("c1", "c2", "c3", "c4", "tp", "fp", "fn", "tn", "total", "gt_total", "method_total"),
)
"""Counts of a frame or an annotation, in the published order.

`c13` is a point of the object that the method put in category 3, `c-13` one in the box but not of
the object, `c3` one outside of every box; `c10` and `c-10` have no category.
"""

_CODES: Final = (-11, -12, -13, -14, 11, 12, 13, 14, -10, 10, 1, 2, 3, 4)
_BOGUS_ROW: Final = (-1.0, -1.0, -1.0, -1.0)


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPoints:
    """True points, followed by the method's points outside every box.

    Attributes:
        points_m: (K, 3) coordinates.
        code: (K,) int8: the tens mark a point inside a box, a negative sign one that is not of the
            object; the units are the category.
        method_total: Number of points that the method labelled.
    """

    points_m: Points
    code: NDArray[np.int8]
    method_total: int

    def annotation_code(self) -> NDArray[np.int8]:
        """(N,) codes of the true points alone, which count for a single annotation."""
        return self.code[np.abs(self.code) >= 10]

    def counts(self) -> NDArray[np.int64]:
        """(21,) counts of a frame, in the order of `COLUMNS`."""
        return _counts(self.code, self.method_total)

    def annotation_counts(self) -> NDArray[np.int64]:
        """(21,) counts of a single annotation, in the order of `COLUMNS`."""
        return _counts(self.annotation_code(), self.method_total)


def match_points(
    true_points: NDArray[np.float32],
    method_points_m: Points,
    category: NDArray[np.integer],
    *,
    form: Form = Form.CORRECTED,
) -> MatchedPoints:
    """Match each true point to the first of the method's points within a millimetre on each axis.

    Several true points may match one point of the method. The corrected form differs from the
    published code in this:

    - the row (-1, -1, -1, -1) with which every published file begins is left out;
    - a point inside two boxes, and therefore listed twice, counts once; it is of the object if it
      is so in one box.

    Args:
        true_points: (N, 4) x, y, z in metres, +1 of the object or -1 not.
        method_points_m: (M, 3) points that the method labelled.
        category: (M,) 1 to 4.
        form: Corrected or published form.
    """
    from scipy.spatial import cKDTree

    if form is Form.CORRECTED:
        true_points = _once(true_points[(true_points != _BOGUS_ROW).any(axis=1)])
    places, label = true_points[:, :3].astype(np.float64), np.sign(true_points[:, 3])
    method = method_points_m.astype(np.float64)
    near = cKDTree(method).query_ball_point(places, 1.5 * TOLERANCE_M, p=np.inf)
    code = (10 * label).astype(np.int8)
    found = np.zeros(len(method), dtype=np.bool_)
    for row, candidates in enumerate(near):
        chosen = np.sort(np.asarray(candidates, dtype=np.intp))
        apart = np.abs(method[chosen] - places[row])
        chosen = chosen[(apart <= TOLERANCE_M).all(axis=1)]
        if len(chosen):
            code[row] += np.int8(label[row] * category[chosen[0]])
            found[chosen[0]] = True
    outside = np.flatnonzero(~found)
    return MatchedPoints(
        np.concatenate((true_points[:, :3], method_points_m[outside])).astype(np.float32),
        np.concatenate((code, category[outside].astype(np.int8))),
        len(method),
    )


def _once(true_points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Keep one row per position, the object's if there is one, in order of first occurrence."""
    _, first, place = np.unique(true_points[:, :3], axis=0, return_index=True, return_inverse=True)
    label = np.full(len(first), -1, dtype=np.float32)
    np.maximum.at(label, place.ravel(), true_points[:, 3])
    order = np.argsort(first)
    once = true_points[first[order]].copy()
    once[:, 3] = label[order]
    return once


def sums_of(each: NDArray[np.int64]) -> NDArray[np.int64]:
    """Derive tp, fp, fn, tn, total and gt_total from the counts of each code.

    Args:
        each: (..., 14) the first columns of `COLUMNS`.

    Returns:
        (..., 6) the derived counts.
    """
    of = dict(zip(_CODES, np.moveaxis(each, -1, 0), strict=True))
    tp = of[13] + of[14]
    fp = of[-13] + of[-14] + of[3] + of[4]
    fn = of[11] + of[12] + of[10]
    tn = of[-11] + of[-12] + of[-10] + of[1] + of[2]
    in_boxes = sum(of[code] for code in _CODES if abs(code) >= 10)
    return np.stack((tp, fp, fn, tn, each.sum(axis=-1), in_boxes), axis=-1)


def _counts(code: NDArray[np.int8], method_total: int) -> NDArray[np.int64]:
    each = np.array([np.count_nonzero(code == number) for number in _CODES], dtype=np.int64)
    return np.concatenate((each, sums_of(each), [method_total]))
