"""What is said of a stretch does not hang on where a log was cut."""

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.frame import PosedFrame
from tests.unit.workers.test_odometry import drive
from workers.odometry.odometry import KissOdometry
from workers.odometry.time_anchored_maps import EVERY_NS, LEAD_NS
from workers.points.se3 import inverse

FAR = 5
"""Half a second of frames."""


def steps(answers: list[PosedFrame]) -> dict[int, NDArray[np.float64]]:
    """How the sensor moved within half a second, by the time at which that ends."""
    return {
        now.frame.stamp_ns: inverse(before.odom_from_sensor) @ now.odom_from_sensor
        for before, now in zip(answers, answers[FAR:], strict=False)
    }


@pytest.mark.parametrize("cut", [3, 11])
def test_poses_of_half_a_second_are_the_same_wherever_a_log_is_cut(cut: int) -> None:
    """To the last digits, unless a speed lies on the edge of being rounded: then under a
    millimetre, until another map begins."""
    frames = list(drive(110, speed_m_per_s=8.0))
    whole, part = steps(list(KissOdometry()(frames))), steps(list(KissOdometry()(frames[cut:])))
    off = {stamp: float(np.abs(part[stamp] - whole[stamp]).max()) for stamp in part}
    begins = -(-frames[cut].stamp_ns // EVERY_NS) * EVERY_NS
    alike_ns = begins + EVERY_NS + LEAD_NS + 600_000_000
    later = [value for stamp, value in off.items() if stamp >= alike_ns]
    first = [value for stamp, value in off.items() if stamp < begins + LEAD_NS]
    assert len(later) > 40
    assert max(later) < 1e-3
    assert np.mean(np.array(later) < 1e-9) > 0.3
    assert np.median(first) > 1e-3


def test_a_map_takes_over_without_a_jump() -> None:
    answers = list(KissOdometry()(drive(60, speed_m_per_s=8.0)))
    x_m = np.array([each.odom_from_sensor[0, 3] for each in answers])
    np.testing.assert_allclose(np.diff(x_m), 0.8, atol=0.05)
    np.testing.assert_allclose(x_m, 0.8 * np.arange(60), atol=0.3)
