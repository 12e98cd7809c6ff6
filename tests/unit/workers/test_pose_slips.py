from collections.abc import Iterable, Iterator

import numpy as np
import pytest

from schemas.frame import LidarFrame, PosedFrame
from tests.factories import BEGIN_NS, FRAME_STEP_NS, frame, pose, posed
from workers.lab.evaluation.failures.pose_slips import Slip, SlippingOdometry


class Driving:
    """An odometry that drives ahead, a metre a frame."""

    version = "driving@1"

    def __call__(self, frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        for number, each in enumerate(frames):
            yield posed(each, pose(float(number)))


def poses(*slips: Slip) -> list[np.ndarray[tuple[int, int], np.dtype[np.float64]]]:
    frames = [frame(np.zeros((1, 3)), at_s=0.1 * number) for number in range(10)]
    return [each.odom_from_sensor for each in SlippingOdometry(Driving(), slips)(frames)]


def test_without_a_slip_poses_stay_as_they_are() -> None:
    for number, each in enumerate(poses()):
        np.testing.assert_allclose(each, pose(float(number)), atol=1e-9)


def test_a_slip_adds_up_while_it_lasts_and_is_never_found_again() -> None:
    slip = Slip(BEGIN_NS + 3 * FRAME_STEP_NS, BEGIN_NS + 5 * FRAME_STEP_NS, 0.0, 0.2)
    travelled = [each[0, 3] for each in poses(slip)]
    assert travelled == pytest.approx([0, 1, 2, 3.2, 4.4, 5.4, 6.4, 7.4, 8.4, 9.4])


def test_a_turn_bends_the_way_that_follows() -> None:
    slip = Slip(BEGIN_NS + 3 * FRAME_STEP_NS, BEGIN_NS + 4 * FRAME_STEP_NS, np.pi / 2, 0.0)
    last = poses(slip)[-1]
    assert last[0, 3] == pytest.approx(3.0)
    assert last[1, 3] == pytest.approx(6.0)


def test_slips_change_the_version() -> None:
    slip = Slip(0, 1, 0.1, 0.0)
    assert SlippingOdometry(Driving(), [slip]).version != Driving.version
