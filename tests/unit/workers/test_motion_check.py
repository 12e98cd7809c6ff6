"""Steps of the odometry are held against what the car recorded, as far as that can be believed."""

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.contradiction import LabelledFrame, SceneState
from schemas.frame import OdometryState, RecordedMotion
from schemas.labels import MotionLabel
from tests.factories import frame, labelled, pose, posed, scene
from workers.contradiction.reasons import reasons_of
from workers.contradiction.scene_statistics import odometry_health, statistics_of
from workers.contradiction.score import judge_odometry
from workers.witness.free_space import TwoSidedFreeSpace
from workers.witness.recorded_motion import FEWEST, MotionCheck, MotionComparison

STEP_S = 0.1


def going(speed: float, turn: float = 0.0) -> NDArray[np.float64]:
    return np.array([0.0, 0.0, turn, speed, 0.0, 0.0])


def after(
    check: MotionCheck, steps: int, ours: NDArray[np.float64], recorded: RecordedMotion
) -> MotionComparison:
    verdict = MotionComparison()
    for _ in range(steps):
        verdict = check.judge(ours, recorded, STEP_S)
    return verdict


def test_a_healthy_odometry_agrees_with_worn_tyres_and_late_brakes() -> None:
    check, speed, recorded = MotionCheck(), 15.0, 15.0
    rng = np.random.default_rng(1)
    for number in range(60):
        speed -= 0.6 * (20 <= number < 40)  # 6 m/s2
        late, recorded = recorded, speed * 1.03 + float(rng.normal(0.0, 0.05))
        ours = going(speed + float(rng.normal(0.0, 0.2)), float(rng.normal(0.0, 0.01)))
        moved = RecordedMotion((late + recorded) / 2, abs(float(rng.normal(0.0, 0.004))))
        assert check.judge(ours, moved, STEP_S) == MotionComparison()


@pytest.mark.parametrize(
    ("ours", "said"),
    [
        (going(14.0), "differs from the recorded odometry by 0.40 m and 0.0 degrees"),
        (going(10.0, np.radians(12.0)), "by 0.00 m and 1.2 degrees"),
    ],
)
def test_a_slip_is_told_by_how_far_it_went(ours: NDArray[np.float64], said: str) -> None:
    check = MotionCheck()
    assert after(check, 10, going(10.0), RecordedMotion(10.0, 1e-3)) == MotionComparison()
    verdict = check.judge(ours, RecordedMotion(10.0, 1e-3), STEP_S)
    assert said in verdict.problem
    assert verdict.remark == ""
    assert after(check, 1, going(10.0), RecordedMotion(10.0, 1e-3)) == MotionComparison()


def test_a_lidar_far_ahead_of_the_wheels_goes_faster_in_a_turn() -> None:
    turn = 0.6
    ours = np.array([0.0, 0.0, turn, 5.0, 3.5 * turn, 0.0])
    assert after(MotionCheck(), 30, ours, RecordedMotion(5.0, turn)) == MotionComparison()


@pytest.mark.parametrize("factor", [0.0, 3.6, 2.24])
def test_a_recording_that_never_agrees_is_not_believed(factor: float) -> None:
    check = MotionCheck()
    # at a red light it agrees, and is not believed for that
    after(check, 50, going(0.0), RecordedMotion(0.0, 0.0))
    verdicts = [
        check.judge(going(9.0), RecordedMotion(9.0 * factor, 0.0), STEP_S) for _ in range(40)
    ]
    assert {verdict.problem for verdict in verdicts} == {""}
    assert [bool(verdict.remark) for verdict in verdicts] == [False] * (FEWEST - 1) + [True] * 33
    assert "recorded odometry not believed: 100% of the last 30 steps" in verdicts[-1].remark


def test_a_recording_that_freezes_on_the_way_is_doubted_for_a_moment_only() -> None:
    check = MotionCheck()
    after(check, 40, going(9.0), RecordedMotion(9.0, 1e-3))
    verdicts = [check.judge(going(14.0), RecordedMotion(9.0, 1e-3), STEP_S) for _ in range(40)]
    assert [bool(verdict.problem) for verdict in verdicts] == [True] * 15 + [False] * 25


def test_an_odometry_that_stands_while_the_wheels_turn_is_what_failed() -> None:
    check = MotionCheck()
    verdicts = [
        check.judge(going(0.3), RecordedMotion(24.0 + 0.01 * (number % 3), 1e-3), STEP_S)
        for number in range(40)
    ]
    assert all(verdict.problem for verdict in verdicts[FEWEST - 1 :])
    assert {verdict.remark for verdict in verdicts} == {""}


def test_wheel_speed_without_a_turn_says_nothing_of_turns() -> None:
    check = MotionCheck()
    assert after(check, 30, going(6.0, 0.5), RecordedMotion(6.0, 0.0)) == MotionComparison()
    assert "0.40 m" in check.judge(going(10.0, 0.5), RecordedMotion(6.0, 0.0), STEP_S).problem


def tunnel() -> tuple[NDArray[np.float32], NDArray[np.int16]]:
    """Sixteen beams in a tunnel 10 m wide and 6 m high: from everywhere in it the same."""
    azimuth, ring = np.meshgrid(np.radians(np.arange(0.0, 360.0, 2.0)), np.arange(16))
    up = np.tan(np.radians(np.linspace(-15.0, 25.0, 16)))[ring]
    with np.errstate(divide="ignore"):
        away = np.minimum.reduce(
            [
                5.0 / np.abs(np.sin(azimuth)),
                np.where(up > 0.0, 4.0 / up, -2.0 / up),
                np.full(azimuth.shape, 60.0),
            ]
        )
    points = np.stack([away * np.cos(azimuth), away * np.sin(azimuth), away * up], axis=-1)
    return points.reshape(-1, 3).astype(np.float32), ring.reshape(-1).astype(np.int16)


def through_the_tunnel(
    *, slips_at: int, recorded_m_per_s: float | None, count: int = 40
) -> Iterator[LabelledFrame]:
    """Drive 15 m/s; one step is 0.8 m too long."""
    points, ring = tunnel()
    still = np.full(len(points), MotionLabel.STATIC)
    for number in range(count):
        moved = None
        if recorded_m_per_s is not None and number:
            moved = RecordedMotion(recorded_m_per_s, 1e-3)
        made = frame(points, at_s=number * STEP_S, ring=ring, moved=moved)
        where = posed(made, pose(1.5 * number + 0.8 * (number >= slips_at)))
        said = labelled(points, still, still)
        yield LabelledFrame(where, said.semantic, said.predictive, said.agreements, said.task)


def test_a_step_ahead_in_a_tunnel_is_seen_by_the_wheels_alone() -> None:
    witness = TwoSidedFreeSpace()
    unseen = list(witness(through_the_tunnel(slips_at=20, recorded_m_per_s=None)))
    assert {each.posed.odometry for each in unseen} == {OdometryState.HEALTHY}
    assert {each.posed.remark for each in unseen} == {""}
    seen = list(witness(through_the_tunnel(slips_at=20, recorded_m_per_s=15.0)))
    doubted = [n for n, each in enumerate(seen) if each.posed.odometry is OdometryState.DEGRADED]
    assert doubted == list(range(20, 31))  # as long as streams remember
    assert "differs from the recorded odometry by 0.80 m" in seen[25].posed.reason
    assert [each.posed.jumped for each in seen].index(True) == 20


def test_a_frozen_recording_gates_nothing_and_is_said_once() -> None:
    witness = TwoSidedFreeSpace()
    seen = scene(list(witness(through_the_tunnel(slips_at=99, recorded_m_per_s=0.0))))
    state = judge_odometry(seen)
    health = odometry_health(seen)
    assert (state, health.state, health.reason) == (SceneState.SCORED, OdometryState.HEALTHY, "")
    told = reasons_of(seen, (), (), state=state, statistics=statistics_of(seen))
    assert sum("recorded odometry not believed" in each.headline for each in told) == 1
