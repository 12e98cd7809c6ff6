"""The first sweep of a stretch, whose motion is known only when the next one arrives."""

import numpy as np
import pytest

from schemas.frame import LidarFrame, OdometryState, PosedFrame
from workers.selfsupervised.bent_sweeps import BentSweeps
from workers.witness.observation import _velocity_to

PERIOD_NS = 100_000_000
START_NS = 1_700_000_000_000_000_000


def _frame(number: int, *, timed: bool = True) -> LidarFrame:
    n = 200
    return LidarFrame(
        log_id="fleet/car-1/drive",
        stamp_ns=START_NS + number * PERIOD_NS,
        points_m=np.ones((n, 3), np.float32),
        intensity=np.zeros(n, np.float32),
        offset_ns=(np.arange(n) * (PERIOD_NS // n) * timed).astype(np.int32),
        ring=np.full(n, -1, np.int16),
        valid_mask=np.ones(n, np.bool_),
        has_point_time=timed,
    )


def _ahead(m_per_s: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([0.0, 0.0, 0.0, m_per_s, 0.0, 0.0])


@pytest.mark.parametrize(
    ("m_per_s", "timed", "bent"),
    [(15.0, True, True), (0.5, True, False), (15.0, False, False)],
    ids=["it drives", "it creeps", "no time per point"],
)
def test_the_second_frame_shows_that_the_first_is_bent(
    m_per_s: float, *, timed: bool, bent: bool
) -> None:
    sweeps, first, second = BentSweeps(), _frame(0, timed=timed), _frame(1, timed=timed)
    assert sweeps.found(first, None) is None
    assert sweeps.found(second, _ahead(m_per_s)) == (first.stamp_ns if bent else None)
    assert sweeps.was_bent(first.stamp_ns) is bent
    assert sweeps.found(_frame(2, timed=timed), _ahead(m_per_s)) is None


def _posed(number: int, x_m: float, state: OdometryState) -> PosedFrame:
    pose = np.eye(4)
    pose[0, 3] = x_m
    return PosedFrame(_frame(number), pose, state, 0.03)


@pytest.mark.parametrize(
    ("number", "state", "m_per_s"),
    [
        (1, OdometryState.HEALTHY, 15.0),
        (1, OdometryState.LOST, None),
        (9, OdometryState.HEALTHY, None),
    ],
    ids=["the next step", "the next pose is lost", "a gap follows"],
)
def test_the_witness_takes_the_motion_of_a_first_frame_from_the_next_step(
    number: int, state: OdometryState, m_per_s: float | None
) -> None:
    first = _posed(0, 0.0, OdometryState.HEALTHY)
    velocity = _velocity_to(first, _posed(number, 1.5, state))
    assert (velocity is None) == (m_per_s is None)
    if velocity is not None:
        assert velocity[3] == pytest.approx(m_per_s)
