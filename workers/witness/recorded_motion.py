"""Recorded-motion check: steps of the odometry against the car's own recording."""

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from schemas.frame import RecordedMotion
from workers.lidar.deskew import Twist

NOISE_M: Final = 0.12
NOISE_RAD: Final = float(np.radians(0.4))
"""Noise of one step of a healthy odometry, slightly over the threshold of a slip."""

SCALE: Final = 0.04
TURN_SCALE: Final = 0.10
"""Relative errors of recorded speed and turn rate.

Tyre wear, load and wheel slip change the speed by a few parts in a hundred. Turn rates are often
those of steered wheels, and the axis of a lidar leans."""

LATE_S: Final = 0.05
"""Largest offset between the two clocks, and lag of recorded values, seconds."""

AHEAD_M: Final = 4.0
ASIDE_M: Final = 1.0
ABOVE_M: Final = 2.0
"""Largest distances between the lidar and the place that the recorded speed refers to, metres.

Another place of a car that turns, pitches or rolls has another speed."""

TILTS_RAD_PER_S: Final = 0.5
"""Largest rate of roll and pitch that excuses a difference: a car over a speed bump."""

STILL_M_PER_S: Final = 0.5
STILL_RAD_PER_S: Final = float(np.radians(2.0))
DRIVES_M_PER_S: Final = 3.0
FASTEST_M_PER_S: Final = 70.0
CREEPS: Final = 0.1
"""Speed ratio below which the odometry never locked on and creeps; units of speed differ less."""

FEWEST: Final = 8
"""Steps with motion after which a recording can be judged, and believed."""

REMEMBERED: Final = 30
AGREEING: Final = 0.5
_SAME: Final = 1e-9


@dataclass(frozen=True, slots=True)
class MotionComparison:
    """Result of comparing one step.

    Attributes:
        problem: The difference in words; empty where there is none, or nothing is known.
        remark: Reason not to believe the recording; empty where it is believed, or absent.
    """

    problem: str = ""
    remark: str = ""


@dataclass(frozen=True, slots=True)
class _Step:
    ours_m_per_s: float
    recorded_m_per_s: float
    agrees: bool


class MotionCheck:
    """Compares single steps, and the recording as a whole: one that seldom agrees is not believed.

    Wrong units, another vehicle's motion or a frozen value are not faults of the odometry. Steps
    without any motion are not counted, so a value frozen at zero is not believed for having agreed
    at a red light. In the opposite case, where the odometry is still and the recording drives and
    varies, the odometry has failed.
    """

    def __init__(self) -> None:
        self._steps: deque[_Step] = deque(maxlen=REMEMBERED)
        self._before: RecordedMotion | None = None
        self._has_turns = False

    def judge(
        self, velocity: Twist, moved: RecordedMotion | None, step_s: float
    ) -> MotionComparison:
        """Compare one step of the odometry with the recording.

        Args:
            velocity: (6,) twist of the sensor per second, in its own space.
            moved: The recording of the same time; None where there is none.
            step_s: That time, seconds.
        """
        before, self._before = self._before, moved
        if moved is None:
            return MotionComparison(remark=self._distrust())
        ours = float(np.linalg.norm(velocity[3:])), abs(float(velocity[2]))
        self._has_turns |= moved.turn_rad_per_s > 0.0
        turn = moved.turn_rad_per_s if self._has_turns else ours[1]
        off_m = abs(ours[0] - moved.speed_m_per_s) * step_s
        off_rad = abs(ours[1] - turn) * step_s
        speeding = turning = 0.0
        if before is not None:
            speeding = abs(moved.speed_m_per_s - before.speed_m_per_s) / step_s
            turning = abs(moved.turn_rad_per_s - before.turn_rad_per_s) / step_s
        most_m = NOISE_M + step_s * (
            SCALE * moved.speed_m_per_s
            + LATE_S * speeding
            + _lever_m_per_s(moved.speed_m_per_s, turn)
            + ABOVE_M * min(float(np.hypot(velocity[0], velocity[1])), TILTS_RAD_PER_S)
        )
        most_rad = NOISE_RAD + step_s * (TURN_SCALE * turn + LATE_S * turning)
        agrees = off_m <= most_m and off_rad <= most_rad
        if (
            max(ours[0], moved.speed_m_per_s) > STILL_M_PER_S
            or max(ours[1], moved.turn_rad_per_s) > STILL_RAD_PER_S
        ):
            self._steps.append(_Step(ours[0], moved.speed_m_per_s, agrees))
        remark = self._distrust()
        if agrees or remark or len(self._steps) < FEWEST:
            return MotionComparison(remark=remark)
        return MotionComparison(
            problem=f"the step differs from the recorded odometry by {off_m:.2f} m and "
            f"{np.degrees(off_rad):.1f} degrees"
        )

    def _distrust(self) -> str:
        """Return why the recording is not believed; empty where it is, or too little is known."""
        steps = self._steps
        if len(steps) < FEWEST:
            return ""
        agreeing = sum(step.agrees for step in steps) / len(steps)
        if agreeing >= AGREEING or self._odometry_is_still():
            return ""
        speeds = [step.recorded_m_per_s for step in steps]
        return (
            f"recorded odometry not believed: {1 - agreeing:.0%} of the last {len(steps)} steps "
            f"differ (median {np.median(speeds):.1f} m/s recorded, "
            f"{np.median([step.ours_m_per_s for step in steps]):.1f} m/s by the lidar)"
        )

    def _odometry_is_still(self) -> bool:
        """Return True if the odometry is still while the recording drives and varies."""
        recorded = np.array([step.recorded_m_per_s for step in self._steps])
        ours = np.array([step.ours_m_per_s for step in self._steps])
        usual = float(np.median(recorded))
        drives = DRIVES_M_PER_S < usual < FASTEST_M_PER_S and float(np.std(recorded)) > _SAME
        return drives and float(np.median(ours)) < CREEPS * usual


def _lever_m_per_s(speed_m_per_s: float, turn_rad_per_s: float) -> float:
    """Return the largest difference in speed between two places of a turning car."""
    ahead = turn_rad_per_s * AHEAD_M
    longer = ahead**2 / (2 * speed_m_per_s) if speed_m_per_s > ahead else ahead
    return turn_rad_per_s * ASIDE_M + longer
