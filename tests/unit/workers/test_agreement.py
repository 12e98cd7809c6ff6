import numpy as np
import pytest

from schemas.labels import Agreement, MotionLabel
from tests.golden.categories import categories
from workers.contradiction.agreement import compare

STATIC, DYNAMIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN


@pytest.mark.parametrize(
    ("semantic", "predictive", "expected"),
    [
        pytest.param(STATIC, STATIC, Agreement.BOTH_STATIC, id="a wall"),
        pytest.param(DYNAMIC, DYNAMIC, Agreement.BOTH_DYNAMIC, id="a driving car"),
        pytest.param(DYNAMIC, STATIC, Agreement.ONLY_SEMANTIC_DYNAMIC, id="a phantom mover"),
        pytest.param(STATIC, DYNAMIC, Agreement.ONLY_PREDICTIVE_DYNAMIC, id="a missed mover"),
        pytest.param(UNKNOWN, DYNAMIC, Agreement.NOT_COMPARED, id="outside the field of view"),
        pytest.param(DYNAMIC, UNKNOWN, Agreement.NOT_COMPARED, id="beyond the range of the flow"),
        pytest.param(UNKNOWN, STATIC, Agreement.NOT_COMPARED, id="no past frame"),
        pytest.param(STATIC, UNKNOWN, Agreement.NOT_COMPARED, id="never seen before"),
        pytest.param(UNKNOWN, UNKNOWN, Agreement.NOT_COMPARED, id="no return"),
    ],
)
def test_each_pair_of_labels_has_one_agreement(
    semantic: MotionLabel, predictive: MotionLabel, expected: Agreement
) -> None:
    one = np.array([semantic], dtype=np.uint8)
    other = np.array([predictive], dtype=np.uint8)
    assert compare(one, other).tolist() == [expected]


def test_agreements_are_bytes_in_the_order_of_the_points() -> None:
    semantic = np.array([0, 1, 0, 1, 2], dtype=np.uint8)
    predictive = np.array([0, 0, 1, 1, 1], dtype=np.uint8)
    agreements = compare(semantic, predictive)
    assert agreements.dtype == np.uint8
    assert agreements.tolist() == [
        Agreement.BOTH_STATIC,
        Agreement.ONLY_SEMANTIC_DYNAMIC,
        Agreement.ONLY_PREDICTIVE_DYNAMIC,
        Agreement.BOTH_DYNAMIC,
        Agreement.NOT_COMPARED,
    ]


def test_streams_that_labelled_different_points_are_refused() -> None:
    with pytest.raises(ValueError, match="3 semantic, 2 predictive; a stage must never drop"):
        compare(np.zeros(3, dtype=np.uint8), np.zeros(2, dtype=np.uint8))


def test_an_empty_frame_has_no_agreements() -> None:
    nothing = np.zeros(0, dtype=np.uint8)
    assert len(compare(nothing, nothing)) == 0


def test_the_papers_numbers_are_one_to_four_and_none_where_nothing_was_compared() -> None:
    semantic = np.array([0, 1, 0, 1, 2], dtype=np.uint8)
    predictive = np.array([0, 1, 1, 0, 1], dtype=np.uint8)
    assert categories(compare(semantic, predictive)).tolist() == [1, 2, 3, 4, 0]
