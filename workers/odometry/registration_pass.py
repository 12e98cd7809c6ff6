"""One pass of KISS-ICP over a stretch of frames: a pose, its residual and its health per frame."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Mask, Points, Transform
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from workers.lidar.deskew import Twist, twist
from workers.lidar.enough_points import too_few_returns
from workers.odometry.health import LOST_RESIDUAL_M, HealthMonitor, PoseHealth, Residual
from workers.odometry.kiss_map import MAX_RANGE_M
from workers.odometry.time_anchored_maps import TimeAnchoredMaps
from workers.points.compiled import compiled
from workers.points.neighbours import PointGrid, build_grid, nearest_distances
from workers.points.se3 import inverse, transform

MAX_GAP_S: Final = 0.5
"""Longest gap between frames, seconds; after it the constant velocity of ICP is no prediction."""

MIN_RANGE_M: Final = 2.5

RESIDUAL_REACH_M: Final = 1.0

_SOUND: Final = 5
"""Consecutive good frames after which a bad pose is an exception; in the first frames of a stretch
each step corrects the one before."""


class RegistrationPass:
    """State of one pass over a stretch of frames."""

    def __init__(self, pose: Transform | None = None, velocity: Twist | None = None) -> None:
        """Begin at a pose, with a twist per second; None where unknown."""
        self.stamp_ns: int | None = None
        self._pose: Transform = np.eye(4) if pose is None else pose
        self._restarted = ""
        self._begin(velocity)

    def _begin(self, velocity: Twist | None) -> None:
        """Forget the map and the motion, and keep the pose."""
        self._maps = TimeAnchoredMaps(self._pose, velocity)
        self._velocity: Twist | None = None
        self._registered_ns: int | None = None
        self._previous: PointGrid | None = None
        self._health = HealthMonitor()
        self._sound = 0

    def restart(self, velocity: Twist | None = None, *, why: str = "") -> "RegistrationPass":
        """Begin another pass at the last pose of this one.

        Args:
            velocity: Twist of the sensor at first, per second; zero when None.
            why: Reason for the break between the two; empty where there is none.
        """
        run = RegistrationPass(self._pose, velocity)
        run.stamp_ns = self.stamp_ns
        run._restarted = why or self._restarted
        return run

    def pose(self, frame: LidarFrame) -> PosedFrame:
        """Register one frame."""
        dt_s = 0.0 if self.stamp_ns is None else (frame.stamp_ns - self.stamp_ns) / NS_PER_S
        restarted, self._restarted = self._restarted, ""
        if self.stamp_ns is not None and not 0.0 < dt_s <= MAX_GAP_S:
            restarted = f"no frame for {dt_s:.2f} s"
            if dt_s <= 0.0:
                restarted = f"time went back by {-dt_s:.2f} s" if dt_s else "time stood still"
            self._begin(None)
        self.stamp_ns = frame.stamp_ns

        points = usable(frame.points_m, frame.valid_mask)
        predicted = self._maps.expected(frame.stamp_ns)
        problem = too_few_returns(points)
        if problem:
            return self._unregistered(frame, predicted, problem)
        pose, keypoints = self._maps.register(points, frame.stamp_ns, self._velocity)
        if pose is None:
            self._begin(None)
            return self._unregistered(frame, predicted, "registration did not converge")

        residual = self._residual(keypoints, pose)
        judged, velocity = PoseHealth(), None
        if self._registered_ns is not None:
            velocity = twist(inverse(self._pose) @ pose) / dt_s
            judged = self._health.judge(velocity, dt_s, residual)
            if self._is_outlier(judged, residual, frame.stamp_ns):
                return self._unregistered(frame, predicted, f"not believed: {judged.reason}")
            self._health.remember(velocity, residual.median_m)
        self._velocity = velocity
        self._maps.accept()
        self._pose, self._registered_ns = pose, frame.stamp_ns
        self._sound = 0 if judged.state is OdometryState.LOST else self._sound + 1
        self._previous = build_grid(transform(pose, structure(points)), pose[:3, 3])
        if restarted:
            judged = PoseHealth(OdometryState.DEGRADED, f"odometry starts anew: {restarted}")
        return PosedFrame(
            frame, pose.copy(), judged.state, residual.median_m, judged.reason, jumped=judged.jumped
        )

    def _is_outlier(self, judged: PoseHealth, residual: Residual, stamp_ns: int) -> bool:
        """Return True if a registration is impossible for a car and fits nothing, after good ones.

        Added to the map, it would distort later poses. Half a second of them is no exception.
        """
        impossible = judged.jumped and judged.state is OdometryState.LOST
        wrong = impossible and residual.median_m > LOST_RESIDUAL_M and self._sound >= _SOUND
        since = self._registered_ns
        return wrong and since is not None and (stamp_ns - since) / NS_PER_S <= MAX_GAP_S

    def _unregistered(self, frame: LidarFrame, pose: Transform, problem: str) -> PosedFrame:
        """Return the frame with a predicted pose, which is accepted for half a second."""
        since = self._registered_ns
        blind_s = np.inf if since is None else (frame.stamp_ns - since) / NS_PER_S
        state = OdometryState.DEGRADED
        if blind_s > MAX_GAP_S:
            state = OdometryState.LOST
            self._begin(None)
        else:
            self._pose = pose
            self._maps.continue_from(pose, frame.stamp_ns)
        return PosedFrame(frame, pose.copy(), state, reason=problem)

    def _residual(self, keypoints: NDArray[np.float64], pose: Transform) -> Residual:
        """Measure distances of this frame's key points to the frame before, metres, at most 1."""
        if self._previous is None:
            return Residual()
        placed = transform(pose, structure(keypoints))
        return Residual.of(nearest_distances(self._previous, placed, RESIDUAL_REACH_M))


@compiled
def usable(points: Points, valid: Mask) -> Points:
    """Select returns between the nearest and the farthest registered range, (M, 3)."""
    rows = np.empty(points.shape, np.float32)
    count = 0
    for i in range(len(points)):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        squared = x * x + y * y + z * z
        if valid[i] and MIN_RANGE_M**2 < squared < MAX_RANGE_M**2:
            rows[count] = points[i]
            count += 1
    return rows[:count].copy()


@compiled
def structure(points: NDArray[np.floating]) -> NDArray[np.floating]:
    """Select points off the road within 40 m: rings on the road move with the car."""
    rows = np.empty(points.shape, points.dtype)
    count = 0
    for i in range(len(points)):
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        if points[i, 2] > -1.0 and x * x + y * y < 40.0**2:
            rows[count] = points[i]
            count += 1
    return rows[:count].copy()
