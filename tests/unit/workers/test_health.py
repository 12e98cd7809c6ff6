"""Poses are lost where nothing fits, and doubted where only what stands among traffic does."""

import math

import numpy as np
import pytest

from schemas.frame import OdometryState
from workers.odometry.health import HealthMonitor, PoseHealth, Residual

DRIVES = np.array([0.0, 0.0, 0.0, 25.0, 0.0, 0.0])


def _judged(residual: Residual, *, jump_m: float = 0.0) -> PoseHealth:
    monitor = HealthMonitor()
    for _ in range(5):
        monitor.remember(DRIVES, 0.3)
    return monitor.judge(DRIVES + np.array([0, 0, 0, jump_m / 0.1, 0, 0]), 0.1, residual)


@pytest.mark.parametrize(
    ("residual", "state"),
    [
        (Residual(0.3, 0.1, 300), OdometryState.HEALTHY),
        (Residual(0.7, 0.15, 300), OdometryState.DEGRADED),  # most of it drives along
        (Residual(0.7, 0.45, 300), OdometryState.LOST),
        (Residual(0.7, 0.15, 40), OdometryState.LOST),  # ten points are no quarter of a street
        (Residual(), OdometryState.DEGRADED),
    ],
)
def test_a_quarter_that_stands_keeps_a_pose_from_being_lost(
    residual: Residual, state: OdometryState
) -> None:
    assert _judged(residual).state is state


def test_a_quarter_that_stands_excuses_no_jump() -> None:
    judged = _judged(Residual(0.7, 0.15, 300), jump_m=3.0)
    assert (judged.state, judged.jumped) == (OdometryState.LOST, True)


def test_a_residual_sums_up_distances() -> None:
    found = Residual.of(np.array([1.0, 0.1, 0.2, 0.3, 1.0], np.float32))
    assert found.points == 5
    assert found.median_m == pytest.approx(0.3)
    assert found.quarter_m == pytest.approx(0.2)
    nothing = Residual.of(np.zeros(0))
    assert math.isnan(nothing.median_m)
    assert not nothing.fits_nowhere
