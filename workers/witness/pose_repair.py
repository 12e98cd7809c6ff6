"""Pose repair: a second registration checks consecutive poses and corrects steps for the witness.

A slip is an error between two frames that static structure contradicts, in one step or gradually
over half a second. A step is corrected, so the witness still sees past it. The streams used the
pose, so their labels are doubted for as long as they remember it.
"""

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from schemas.arrays import NS_PER_S, Points, Transform
from workers.lidar.registration_check import (
    Misfit,
    Structure,
    extract_structure,
    register_structures,
)
from workers.points.se3 import transform

STEP_M: Final = 0.10
STEP_RAD: Final = float(np.radians(0.25))
"""Smallest slip from one frame to the next, metres and radians.

On real and simulated streets the second registration differs from a healthy odometry by at most
0.04 m and 0.10 degrees. A smaller slip moves no static object out of the margins of free space."""

TILT_RAD: Final = float(np.radians(1.5))
"""Smallest tilt that is a slip, at any age; healthy poses in a bare street reach 0.8 degrees."""

SLOW_M: Final = 0.20
SLOW_RAD: Final = float(np.radians(0.8))
"""Smallest slip over half a second; healthy odometry is off by up to 0.1 m and 0.5 degrees."""

BETTER: Final = 0.7
"""Largest ratio of the distances to planes after and before the correction."""

SLOW_EVERY: Final = 3

SLOW_NS: Final = NS_PER_S // 2
_LEAST_SHARE: Final = 0.6
"""Share of the structure that must be found again for a result."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseRepair:
    """Result of the second registration of one frame.

    Attributes:
        problem: The pose error in words; empty where the pose fits, or nothing is known.
        correction: (4, 4) that corrects the frame, odom space; None where it stays.
    """

    problem: str = ""
    correction: Transform | None = None


class PoseCheck:
    """Registers every frame to the one before it, and some to the one half a second before."""

    def __init__(self) -> None:
        self._known: deque[tuple[int, Structure]] = deque()
        self._count = 0

    def clear(self) -> None:
        """Forget the frames so far, which later ones are not consistent with."""
        self._known.clear()

    def judge(self, static_m: Points, odom_from_sensor: Transform, stamp_ns: int) -> PoseRepair:
        """Compare a frame with those before it.

        Args:
            static_m: (N, 3) its places off the ground that no stream labels dynamic, odom space.
            odom_from_sensor: (4, 4) its pose, with earlier slips corrected.
            stamp_ns: Its time.
        """
        structure = extract_structure(static_m, odom_from_sensor[:3, 3])
        if structure is None:
            self.clear()
            return PoseRepair()
        fit = self._fit(structure, stamp_ns)
        if fit.correction is not None:
            moved = transform(fit.correction, static_m)
            centre_m = (fit.correction @ odom_from_sensor)[:3, 3]
            structure = extract_structure(moved, centre_m) or structure
        self._known.append((stamp_ns, structure))
        while stamp_ns - self._known[0][0] > SLOW_NS:
            self._known.popleft()
        return fit

    def _fit(self, structure: Structure, stamp_ns: int) -> PoseRepair:
        if not self._known:
            return PoseRepair()
        before_ns, before = self._known[-1]
        step = register_structures(before, structure)
        if step is not None and _off(step, STEP_M, STEP_RAD):
            return PoseRepair(_problem_of(step, stamp_ns - before_ns), step.correction)
        self._count += 1
        first_ns, first = self._known[0]
        if self._count % SLOW_EVERY or stamp_ns - first_ns < SLOW_NS // 2:
            return PoseRepair()
        slow = register_structures(first, structure)
        if slow is not None and _off(slow, SLOW_M, SLOW_RAD):
            return PoseRepair(_problem_of(slow, stamp_ns - first_ns))
        return PoseRepair()


def _off(misfit: Misfit, most_m: float, most_rad: float) -> bool:
    moved = misfit.shift_m > most_m or misfit.turn_rad > most_rad or misfit.tilt_rad > TILT_RAD
    return moved and misfit.share >= _LEAST_SHARE and misfit.after_m < BETTER * misfit.before_m


def _problem_of(misfit: Misfit, age_ns: int) -> str:
    turned = np.degrees(max(misfit.turn_rad, misfit.tilt_rad))
    return (
        f"a second registration is {misfit.shift_m:.2f} m and {turned:.1f} degrees off "
        f"over {age_ns / NS_PER_S:.1f} s"
    )
