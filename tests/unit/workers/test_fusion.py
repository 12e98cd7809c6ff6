import numpy as np
import pytest

from schemas.labels import MotionLabel
from tests.golden.fused_labels import (
    is_dynamic_label,
    semantic_kitti_motion,
    semantic_motion_labels,
)
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


def test_the_published_ids_tell_class_and_motion_at_once() -> None:
    semantic = np.array([26, 26, 11, 43, 33, -1], np.int16)
    motion = np.array([2, 1, 2, 2, 2, 2], np.int16)
    fused = semantic_motion_labels(semantic, motion)
    assert fused.tolist() == [202, 26, 11, 210, 209, -1]
    assert is_dynamic_label(fused).tolist() == [True, False, False, True, True, False]
    assert semantic.tolist() == [26, 26, 11, 43, 33, -1]


def test_as_lidar_mos_writes_it_only_movable_classes_move_whatever_the_instance() -> None:
    semantic = np.array([10, 10 | 7 << 16, 40, 0], np.uint32)
    motion = np.array([9, 251, 251, 251], np.uint32)
    assert semantic_kitti_motion(semantic, motion).tolist() == [9, 251, 9, 9]
