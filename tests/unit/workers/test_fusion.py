import numpy as np
import pytest

from schemas.labels import MotionLabel
from workers.supervised.fusion import confidence_of, fuse

STATIC, DYNAMIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN


@pytest.mark.parametrize(
    ("judged", "movable", "moving", "expected"),
    [
        pytest.param(True, True, True, DYNAMIC, id="a driving car"),
        pytest.param(True, True, False, STATIC, id="a parked car"),
        pytest.param(True, False, True, STATIC, id="a house that seems to move"),
        pytest.param(True, False, False, STATIC, id="a house"),
        pytest.param(False, True, True, UNKNOWN, id="a return outside the field of view"),
        pytest.param(True, True, None, UNKNOWN, id="a car in the very first frame"),
        pytest.param(True, False, None, STATIC, id="a house in the very first frame"),
        pytest.param(False, False, None, UNKNOWN, id="nothing in the very first frame"),
    ],
)
def test_only_what_can_move_and_does_is_dynamic(
    judged: bool, movable: bool, moving: bool | None, expected: MotionLabel
) -> None:
    labels = fuse(
        judged_mask=np.array([judged]),
        movable_mask=np.array([movable]),
        moving_mask=None if moving is None else np.array([moving]),
    )
    assert labels.dtype == np.uint8
    assert labels.tolist() == [expected]


def test_confidence_is_that_of_the_label_given() -> None:
    labels = np.array([DYNAMIC, STATIC, UNKNOWN], dtype=np.uint8)
    sure = confidence_of(labels, np.array([0.75, 0.25, 0.5], dtype=np.float32))
    assert sure.dtype == np.float16
    assert sure.tolist() == [0.75, 0.75, 0.0]


def test_confidence_stays_within_zero_and_one() -> None:
    labels = np.array([DYNAMIC, STATIC], dtype=np.uint8)
    assert confidence_of(labels, np.array([1.001, 1.001], dtype=np.float32)).tolist() == [1.0, 0.0]
