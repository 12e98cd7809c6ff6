"""How long a motion is doubted of which another one was believed before."""

from collections.abc import Callable, Sequence

import pytest

from schemas.frame import OdometryState, PosedFrame
from tests.unit.workers.test_odometry import drive
from workers.lidar.deskew import Twist
from workers.odometry import motion_hypotheses
from workers.odometry.motion_hypotheses import AmbiguousMotion, MotionHypothesis
from workers.odometry.registration_pass import RegistrationPass

HEALTHY, DOUBTED, LOST = OdometryState.HEALTHY, OdometryState.DEGRADED, OdometryState.LOST

Look = tuple[bool, str]
"""Whether another motion than the one believed is likeliest, and what else fits alike."""


def _states(monkeypatch: pytest.MonkeyPatch, looks: Sequence[Look]) -> list[OdometryState]:
    """Drive for eight seconds, with a look each second that finds what it is told to."""
    said = list(looks)

    def look(
        run: RegistrationPass, posed: list[PosedFrame], begin: Callable[[Twist], RegistrationPass]
    ) -> MotionHypothesis:
        changes, alike = said.pop(0)
        if not changes:
            return MotionHypothesis(run, posed, alike)
        other = RegistrationPass(posed[0].odom_from_sensor)
        return MotionHypothesis(other, [other.pose(each.frame) for each in posed], alike)

    monkeypatch.setattr(motion_hypotheses, "most_likely_motion", look)
    run, states, unsure = RegistrationPass(), list[OdometryState](), None
    for number, frame in enumerate(drive(80)):
        now = run.pose(frame)
        if number == 3:
            unsure = AmbiguousMotion(MotionHypothesis(run, [now], "0 m/s would fit alike"))
        elif unsure is not None:
            run, now, unsure = unsure.test_again(run, now)
        states.append(now.odometry)
    assert not said, "looks that were never taken"
    return states[4:]


def test_what_is_clear_at_the_next_look_is_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    states = _states(monkeypatch, [(False, "")])
    assert states == [DOUBTED] * 9 + [HEALTHY] * 67


def test_another_motion_is_doubted_until_two_looks_bear_it_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    states = _states(monkeypatch, [(True, ""), (False, ""), (False, "")])
    assert states == [DOUBTED] * 9 + [LOST] + [DOUBTED] * 19 + [HEALTHY] * 47


def test_a_change_of_mind_and_back_is_doubted_all_along(monkeypatch: pytest.MonkeyPatch) -> None:
    looks = [(True, ""), (True, ""), (False, ""), (False, "")]
    states = _states(monkeypatch, looks)
    assert states[:39] == [DOUBTED] * 9 + [LOST] + [DOUBTED] * 9 + [LOST] + [DOUBTED] * 19
    assert states[39:] == [HEALTHY] * 37


def test_what_is_not_clear_after_five_looks_is_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    states = _states(monkeypatch, [(False, "0 m/s would fit alike")] * 5)
    assert states == [DOUBTED] * 49 + [HEALTHY] * 27
