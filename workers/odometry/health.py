"""Health of odometry: tests a pose against the motion of a car and against static structure."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.frame import OdometryState
from workers.lidar.motion_limits import MAX_ACCELERATION_M_PER_S2, POSE_NOISE_M, POSE_NOISE_RAD

MAX_SPEED_M_PER_S: Final = 70.0
MAX_TURN_RAD_PER_S: Final = 2.0

MAX_TURN_CHANGE_RAD_PER_S2: Final = 5.0
"""Largest change of the turn rate, rad/s²: the pitch of a speed bump, 20 degrees per second within
one or two frames."""


LOST_JUMP_M: Final = 1.0
DEGRADED_RESIDUAL_M: Final = 0.2
LOST_RESIDUAL_M: Final = 0.5
RESIDUAL_JUMP: Final = 2.0

STATIC_M: Final = 0.25
FEWEST_STATIC: Final = 100
"""Distance within which the nearest quarter of the key points is static, and the points needed.

Among cars of the same speed most nearby structure moves with the sensor. Where a quarter of so many
key points is so near, that quarter is static: at wrong poses it was 0.5 m off and more."""

_REMEMBERED: Final = 10


@dataclass(frozen=True, slots=True)
class Residual:
    """Distances of key points off the road to the frame before; NaN without key points.

    Attributes:
        median_m: Median distance.
        quarter_m: Distance of the nearest quarter.
        points: Number of key points.
    """

    median_m: float = math.nan
    quarter_m: float = math.nan
    points: int = 0

    @classmethod
    def of(cls, distances_m: NDArray[np.floating]) -> "Residual":
        """Summarise distances (N,)."""
        if len(distances_m) == 0:
            return cls()
        quarter_m = float(np.quantile(distances_m, 0.25))
        return cls(float(np.median(distances_m)), quarter_m, len(distances_m))

    @property
    def fits_nowhere(self) -> bool:
        """True if most points are elsewhere, and the nearest quarter is not static either."""
        is_static = self.points >= FEWEST_STATIC and self.quarter_m < STATIC_M
        return self.median_m > LOST_RESIDUAL_M and not is_static


@dataclass(frozen=True, slots=True)
class PoseHealth:
    """Health of one pose.

    Attributes:
        state: The state of the odometry.
        reason: Reason for a state other than healthy; empty otherwise.
        jumped: The pose moved as no car can.
    """

    state: OdometryState = OdometryState.HEALTHY
    reason: str = ""
    jumped: bool = False


class HealthMonitor:
    """Judges each pose by the motion and the residuals before it."""

    def __init__(self) -> None:
        self._velocity: NDArray[np.float64] | None = None
        self._residuals_m: deque[float] = deque(maxlen=_REMEMBERED)

    def remember(self, velocity: NDArray[np.float64], residual_m: float) -> None:
        """Add an accepted motion and its residual."""
        self._velocity = velocity
        if np.isfinite(residual_m):
            self._residuals_m.append(residual_m)

    def judge(self, velocity: NDArray[np.float64], dt_s: float, residual: Residual) -> PoseHealth:
        """Judge a registered motion.

        Args:
            velocity: (6,) twist per second since the last registered frame.
            dt_s: Time between the two.
            residual: Residual of its key points.
        """
        residual_m = residual.median_m
        lost, degraded = OdometryState.LOST, OdometryState.DEGRADED
        impossible = self._impossible_motion(velocity, dt_s)
        if impossible.state is not lost and residual.fits_nowhere:
            return PoseHealth(lost, f"structure is {residual_m:.2f} m off")
        if impossible.jumped:
            return impossible
        if np.isnan(residual_m):
            return PoseHealth(degraded, "nothing stands near by which to tell the pose")
        if residual_m > LOST_RESIDUAL_M:
            return PoseHealth(degraded, f"structure is {residual_m:.2f} m off, a quarter stands")
        usual = float(np.median(self._residuals_m)) if self._residuals_m else residual_m
        if residual_m > max(DEGRADED_RESIDUAL_M, RESIDUAL_JUMP * usual):
            reason = f"structure is {residual_m:.2f} m off, {usual:.2f} m is usual"
            return PoseHealth(degraded, reason)
        return PoseHealth()

    def _impossible_motion(self, velocity: NDArray[np.float64], dt_s: float) -> PoseHealth:
        """Judge a motion against the limits of a car: too fast, too sharp a turn, or a jump."""
        speed, turn = float(np.linalg.norm(velocity[3:])), float(np.linalg.norm(velocity[:3]))
        lost, degraded = OdometryState.LOST, OdometryState.DEGRADED
        if speed > MAX_SPEED_M_PER_S:
            return PoseHealth(lost, f"{speed:.0f} m/s is too fast for a car", jumped=True)
        if turn > MAX_TURN_RAD_PER_S:
            reason = f"{np.degrees(turn):.0f} degrees per second is no turn"
            return PoseHealth(lost, reason, jumped=True)
        if self._velocity is None:
            return PoseHealth()
        jump_m = float(np.linalg.norm(velocity[3:] - self._velocity[3:])) * dt_s
        jump_rad = float(np.linalg.norm(velocity[:3] - self._velocity[:3])) * dt_s
        limit_m = MAX_ACCELERATION_M_PER_S2 * dt_s**2 + POSE_NOISE_M
        limit_rad = MAX_TURN_CHANGE_RAD_PER_S2 * dt_s**2 + POSE_NOISE_RAD
        if jump_m > limit_m:
            state = lost if jump_m > limit_m + LOST_JUMP_M else degraded
            return PoseHealth(state, f"pose jumped by {jump_m:.2f} m", jumped=True)
        if jump_rad > limit_rad:
            reason = f"pose turned by {np.degrees(jump_rad):.1f} degrees"
            return PoseHealth(degraded, reason, jumped=True)
        return PoseHealth()
