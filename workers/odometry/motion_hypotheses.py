"""Motion hypotheses: sensor velocities that a few frames allow, tested against each other."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from workers.lidar.deskew import Twist
from workers.odometry.registration_pass import RegistrationPass
from workers.odometry.velocity_initialisation import candidate_velocities, contradicted_share
from workers.points.se3 import inverse

DECISION_S: Final = 0.35
"""Time before the first decision between hypotheses, seconds: five frames at 10 Hz."""

MIN_BUFFERED: Final = 3
_SAME_REGISTRATION_M: Final = 0.5
"""Largest difference of two poses, metres, at which they are, or lead to, the same registration."""

_BETTER: Final = 0.95
"""Ratio of contradicted shares below which a hypothesis is better.

On simulated motorways where the odometry began without motion the ratio was .58 to .87."""

_SIMILAR: Final = 1.25
"""Ratio of contradicted shares up to which a hypothesis may also be true.

On a motorway full of cars of the same speed, no motion was contradicted .12 and the true speed .14;
a second later it was .11 and .09."""

_AGAIN_S: Final = 1.0

_TESTS: Final = 5
"""Tests of a stretch at most. A motion that is unclear by then is accepted, as among cars of the
same speed all around."""

_CONFIRMED: Final = 2
"""Tests that must confirm a hypothesis that replaced another.

On one motorway a single test found no motion, contradicted .12 against .16, while the tests before
and after it found that the car drives."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionHypothesis:
    """The most likely motion of the sensor, given a few frames.

    Attributes:
        registration: The pass that continues with this motion.
        posed: The frames with its poses.
        alternative: Another possible motion, in words; empty where there is none.
    """

    registration: RegistrationPass
    posed: list[PosedFrame]
    alternative: str = ""


def most_likely_motion(
    registration: RegistrationPass,
    posed: list[PosedFrame],
    begin: Callable[[Twist], RegistrationPass],
) -> MotionHypothesis:
    """Choose among the current motion and every other motion that two frames allow.

    Args:
        registration: The pass that posed the frames.
        posed: Consecutive frames.
        begin: Begins another pass before the first of them, with a twist per second.
    """
    frames = [each.frame for each in posed]
    dt_s, first_m, travelled_m = span_s(frames[:2]), moved_m(posed[:2]), moved_m(posed)
    hypotheses = [(float("nan"), registration, posed)]
    for velocity in candidate_velocities(frames[0], frames[1]):
        if np.linalg.norm(velocity[3:] * dt_s - first_m) < _SAME_REGISTRATION_M:
            continue
        other = begin(velocity)
        posed_otherwise = [other.pose(frame) for frame in frames]
        if np.linalg.norm(moved_m(posed_otherwise) - travelled_m) < _SAME_REGISTRATION_M:
            continue
        if len(hypotheses) == 1:
            hypotheses[0] = (contradicted_share(posed), registration, posed)
        hypotheses.append((contradicted_share(posed_otherwise), other, posed_otherwise))
    best = hypotheses[0]
    for hypothesis in hypotheses[1:]:
        if hypothesis[0] < _BETTER * best[0]:
            best = hypothesis
    travelled_m = moved_m(best[2])
    for share_otherwise, _, posed_otherwise in hypotheses:
        apart = (
            float(np.linalg.norm(moved_m(posed_otherwise) - travelled_m)) >= _SAME_REGISTRATION_M
        )
        if apart and share_otherwise <= _SIMILAR * best[0]:
            alternative = f"{_speed(posed_otherwise):.0f} m/s would fit alike"
            return MotionHypothesis(best[1], best[2], alternative)
    return MotionHypothesis(best[1], best[2])


class AmbiguousMotion:
    """A stretch whose sensor motion is ambiguous; its hypotheses are tested again each second."""

    def __init__(
        self, found: MotionHypothesis, *, tests_left: int = _TESTS, confirmations: int = 0
    ) -> None:
        """Begin after the first frames of the stretch.

        Args:
            found: The most likely motion, and the other possible one.
            tests_left: Number of tests left.
            confirmations: Tests that must confirm it even without another possible motion.
        """
        self._posed = list(found.posed)
        self._tests_left = tests_left
        self._confirmations = confirmations
        self._tested_ns = found.posed[-1].frame.stamp_ns
        self._alternative = found.alternative

    def test_again(
        self, registration: RegistrationPass, now: PosedFrame
    ) -> tuple[RegistrationPass, PosedFrame, "AmbiguousMotion | None"]:
        """Mark a pose as degraded, or once a second test the hypotheses again.

        Args:
            registration: The pass that posed the frame.
            now: The frame.

        Returns:
            The pass that continues, the frame with its pose, and the state of the test; None once
            the motion is clear.
        """
        self._posed.append(now)
        since_s = (now.frame.stamp_ns - self._tested_ns) / NS_PER_S
        if since_s < _AGAIN_S:
            return registration, degraded(now, self._alternative), self
        last = [
            each
            for each in self._posed
            if now.frame.stamp_ns - each.frame.stamp_ns <= (DECISION_S + 0.1) * NS_PER_S
        ]
        if len(last) < MIN_BUFFERED:
            return registration, now, None
        start_pose = last[0].odom_from_sensor
        found = most_likely_motion(
            registration, last, lambda velocity: RegistrationPass(start_pose, velocity)
        )
        if found.registration is not registration:
            reason = f"the sensor moves at {_speed(found.posed):.0f} m/s, other than was believed"
            now = replace(found.posed[-1], odometry=OdometryState.LOST, reason=reason, jumped=True)
            found = replace(found, posed=[*found.posed[:-1], now])
            alternative = found.alternative or f"{_speed(last):.0f} m/s was believed before"
            tests_left = max(self._tests_left - 1, _CONFIRMED)
            ambiguous = AmbiguousMotion(
                replace(found, alternative=alternative),
                tests_left=tests_left,
                confirmations=_CONFIRMED,
            )
            return found.registration, now, ambiguous
        if self._tests_left <= 1 or not (found.alternative or self._confirmations > 1):
            return found.registration, now, None
        alternative = found.alternative or self._alternative
        ambiguous = AmbiguousMotion(
            replace(found, alternative=alternative),
            tests_left=self._tests_left - 1,
            confirmations=self._confirmations - 1,
        )
        return found.registration, degraded(now, alternative), ambiguous


def degraded(posed: PosedFrame, alternative: str) -> PosedFrame:
    """Mark a healthy pose as degraded; other states are kept."""
    if posed.odometry is not OdometryState.HEALTHY:
        return posed
    return replace(posed, odometry=OdometryState.DEGRADED, reason=alternative)


def span_s(frames: Sequence[LidarFrame]) -> float:
    """Return the time from the first frame to the last, seconds."""
    return (frames[-1].stamp_ns - frames[0].stamp_ns) / NS_PER_S


def _speed(posed: Sequence[PosedFrame]) -> float:
    return float(np.linalg.norm(moved_m(posed))) / span_s([each.frame for each in posed])


def moved_m(posed: Sequence[PosedFrame]) -> NDArray[np.float64]:
    """Return (3,) the place of the sensor in the last frame, in its space of the first."""
    moved: NDArray[np.float64] = (inverse(posed[0].odom_from_sensor) @ posed[-1].odom_from_sensor)[
        :3, 3
    ]
    return moved
