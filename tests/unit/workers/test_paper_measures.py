import numpy as np
import pytest
from numpy.typing import NDArray

from workers.lab.lidarcoda.matching import COLUMNS, match_points, sums_of
from workers.lab.lidarcoda.measures import Averaging, PointSet, paper_measures
from workers.lidar.fidelity import Form

PAPER = Form.PAPER
INDIVIDUAL, AGGREGATED = Averaging


def _row(**codes: int) -> NDArray[np.int64]:
    """A frame with so many points of each code, `c13=4, beside_14=2`."""
    named = {name.replace("beside_", "c-"): count for name, count in codes.items()}
    each = np.array([named.pop(name, 0) for name in COLUMNS[:14]], dtype=np.int64)
    assert not named
    return np.concatenate((each, sums_of(each), [0]))


def _table(*rows: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.stack(rows)


def test_a_contradiction_on_an_anomaly_is_a_hit_and_one_beside_it_a_false_alarm() -> None:
    counts = _table(_row(c13=3, c14=1, beside_13=2, c11=4, c3=6, c1=100))
    found = paper_measures(counts, PointSet.ALL, clustered=True, averaging=INDIVIDUAL)
    assert found.n == 1
    assert found.mean_iou == pytest.approx(4 / (4 + 8 + 4))
    assert found.average_precision == pytest.approx(4 / 12)
    assert found.average_recall == pytest.approx(4 / 8)
    assert found.f1 == pytest.approx(2 * (1 / 3) * (1 / 2) / (5 / 6))
    assert found.ratios == pytest.approx((4 / 116, 8 / 116, 4 / 116, 100 / 116))


def test_boxes_leave_out_what_is_outside_and_overlap_what_is_unlabelled() -> None:
    counts = _table(_row(c13=3, c10=3, beside_14=1, c4=50))
    boxes, overlap = (
        paper_measures(counts, points, clustered=True, averaging=INDIVIDUAL)
        for points in (PointSet.BOXES, PointSet.OVERLAP)
    )
    assert (boxes.average_precision, boxes.average_recall) == (0.75, 0.5)
    assert (overlap.average_precision, overlap.average_recall) == (0.75, 1.0)


def test_not_clustered_all_points_of_a_box_are_the_anomaly() -> None:
    counts = _table(_row(c13=3, beside_13=1, beside_11=4))
    found = paper_measures(counts, PointSet.BOXES, clustered=False, averaging=INDIVIDUAL)
    assert (found.average_precision, found.average_recall) == (1.0, 0.5)


def test_individual_frames_count_alike_and_aggregated_ones_by_their_points() -> None:
    counts = _table(_row(c13=1, c11=1), _row(c13=100))
    each = paper_measures(counts, PointSet.ALL, clustered=True, averaging=INDIVIDUAL)
    together = paper_measures(counts, PointSet.ALL, clustered=True, averaging=AGGREGATED)
    assert each.average_recall == pytest.approx(0.75)
    assert together.average_recall == pytest.approx(101 / 102)


def test_frames_without_a_denominator_are_left_out_and_as_published_count_as_zero() -> None:
    counts = _table(_row(c13=2), _row(c1=10), _row())
    mended, paper = (
        paper_measures(counts, PointSet.ALL, clustered=True, averaging=INDIVIDUAL, form=form)
        for form in (Form.CORRECTED, PAPER)
    )
    assert (mended.n, mended.average_recall, mended.f1) == (2, 1.0, 1.0)
    assert (paper.n, paper.average_recall, paper.f1) == (2, 0.5, 0.5)


def test_as_published_unlabelled_points_are_missed_in_an_overlap_they_are_not_in() -> None:
    counts = _table(_row(c13=2, c10=2, beside_10=4))
    mended, paper = (
        paper_measures(counts, PointSet.OVERLAP, clustered=False, averaging=INDIVIDUAL, form=form)
        for form in (Form.CORRECTED, PAPER)
    )
    assert sum(mended.ratios) == pytest.approx(1.0)
    assert paper.ratios == (1.0, 0.0, 3.0, 0.0)


@pytest.mark.parametrize("form", list(Form))
def test_no_points_are_no_measures(form: Form) -> None:
    for averaging in Averaging:
        found = paper_measures(
            _table(_row()), PointSet.ALL, clustered=True, averaging=averaging, form=form
        )
        assert (found.n, found.mean_iou, found.f1) == (0, 0.0, 0.0)


BOGUS = (-1.0, -1.0, -1.0, -1.0)
TRUE = np.array([BOGUS, (1, 2, 3, 1), (4, 5, 6, -1), (7, 8, 9, 1), (4, 5, 6, 1)], np.float32)
SAID = np.array([(4.0004, 5, 6), (1, 2.002, 3), (7, 8, 9), (7, 8, 9.0005), (0, 0, 0)], np.float32)
CATEGORY = np.array([3, 1, 4, 2, 1], np.int16)


def test_points_match_within_a_millimetre_the_first_first() -> None:
    found = match_points(TRUE, SAID, CATEGORY, form=PAPER)
    assert found.code.tolist() == [-10, 10, -13, 14, 13, 1, 2, 1]
    assert found.annotation_code().tolist() == [-10, 10, -13, 14, 13]
    assert found.points_m.shape == (8, 3)
    counts = dict(zip(COLUMNS, found.counts().tolist(), strict=True))
    assert (counts["c13"], counts["c-13"], counts["c-10"], counts["c10"]) == (1, 1, 1, 1)
    assert (counts["total"], counts["gt_total"], counts["method_total"]) == (8, 5, 5)
    only = dict(zip(COLUMNS, found.annotation_counts().tolist(), strict=True))
    assert (only["c1"], only["total"], only["fp"]) == (0, 5, 1)


def test_no_bogus_row_and_no_point_counts_twice_in_the_corrected_form() -> None:
    assert match_points(TRUE, SAID, CATEGORY).code.tolist() == [10, 13, 14, 1, 2, 1]


def test_nothing_matches_nothing() -> None:
    nothing = np.zeros((0, 4), np.float32)
    assert match_points(nothing, SAID, CATEGORY).code.tolist() == [3, 1, 4, 2, 1]
    found = match_points(TRUE, nothing[:, :3], CATEGORY[:0], form=PAPER)
    assert found.code.tolist() == [-10, 10, -10, 10, 10]
