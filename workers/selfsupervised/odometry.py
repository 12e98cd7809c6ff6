"""Where the sensor was at each frame, and whether that may be believed: KISS-ICP under guard."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Transform
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from workers.geometry.se3 import inverse, transform
from workers.selfsupervised.beginning import contradicted_share, likely_velocities
from workers.selfsupervised.health import HealthMonitor, Judgement, too_little
from workers.selfsupervised.kiss_map import MAX_RANGE_M
from workers.selfsupervised.maps_by_clock import MapsByClock
from workers.selfsupervised.neighbours import PointGrid, build_grid, nearest_distances
from workers.selfsupervised.versions import version_of
from workers.visibility.deskew import Twist, twist

MAX_GAP_S: Final = 0.5
"""After a longer silence the constant velocity that ICP starts from means nothing."""

MIN_RANGE_M: Final = 2.5
_RESIDUAL_REACH_M: Final = 1.0
BEGINNING_S: Final = 0.35
"""So much is looked at before it is said how the sensor moves: five frames at 10 Hz."""

_MOST_HELD: Final = 10
_FEWEST_HELD: Final = 3
_ANOTHER_M: Final = 0.5
"""Poses that differ by less are the same registration, or lead to it."""

_BETTER: Final = 0.95
"""What free space must contradict less, at most. On simulated motorways on which the odometry began
by standing still it was .58 to .87."""


class KissOdometry:
    """KISS-ICP (`kiss_map.py`) on maps that begin by the clock (`maps_by_clock.py`).

    No frame is ever refused: one that cannot be registered gets the predicted pose and says so.

    The first frames of a stretch are held back for a third of a second. KISS-ICP starts from no
    motion, and between rails and noise walls 2 m a frame fit as well without moving: every speed
    that the first two frames allow is tried beside it, and the one kept that free space contradicts
    least.

    State starts anew after a gap of more than 0.5 s, after time that does not rise, and when a
    registration fails: the pose then goes on from the last one, so what lies between is unknown.
    """

    @property
    def version(self) -> str:
        """`kiss-icp@digest` of code and settings."""
        return version_of("kiss-icp")

    def __call__(self, frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        """Yield each frame with its pose, the first ones once it is known how they move."""
        run, held, begun = _Run(), list[LidarFrame](), False
        for frame in frames:
            if not _follows(held[-1].stamp_ns if held else run.stamp_ns, frame):
                if held:
                    run, posed = _begin(run, held)
                    yield from posed
                held, begun = [], False
            if begun:
                yield run.pose(frame)
                continue
            held.append(frame)
            if _span_s(held) >= BEGINNING_S or len(held) == _MOST_HELD:
                run, posed = _begin(run, held)
                yield from posed
                held, begun = [], True
        if held:
            yield from _begin(run, held)[1]


def _begin(before: "_Run", held: Sequence[LidarFrame]) -> tuple["_Run", list[PosedFrame]]:
    """Register the first frames of a stretch; from no motion, unless another start is better."""
    best = before.anew()
    posed = [best.pose(frame) for frame in held]
    if len(held) < _FEWEST_HELD:
        return best, posed
    dt_s = _span_s(held[:2])
    first_m = _moved_m(posed[:2])
    share = float("nan")
    for velocity in likely_velocities(held[0], held[1]):
        if np.linalg.norm(velocity[3:] * dt_s - first_m) < _ANOTHER_M:
            continue
        other = before.anew(velocity)
        posed_so = [other.pose(frame) for frame in held]
        if np.linalg.norm(_moved_m(posed_so) - _moved_m(posed)) < _ANOTHER_M:
            continue
        share = contradicted_share(posed) if np.isnan(share) else share
        share_so = contradicted_share(posed_so)
        if share_so < _BETTER * share:
            best, posed, share = other, posed_so, share_so
    return best, posed


def _follows(last_ns: int | None, frame: LidarFrame) -> bool:
    """Whether a frame is near enough in time to the one before it, if there is any."""
    return last_ns is None or 0.0 < (frame.stamp_ns - last_ns) / NS_PER_S <= MAX_GAP_S


def _span_s(frames: Sequence[LidarFrame]) -> float:
    return (frames[-1].stamp_ns - frames[0].stamp_ns) / NS_PER_S


def _moved_m(posed: Sequence[PosedFrame]) -> NDArray[np.float64]:
    """(3,) where the sensor is in the last frame, in its space of the first."""
    moved: NDArray[np.float64] = (inverse(posed[0].odom_from_sensor) @ posed[-1].odom_from_sensor)[
        :3, 3
    ]
    return moved


class _Run:
    """State of one pass over a stretch of frames."""

    def __init__(self, pose: Transform | None = None, velocity: Twist | None = None) -> None:
        """Begin at a pose, with a motion per second; None where that is not known."""
        self.stamp_ns: int | None = None
        self._pose: Transform = np.eye(4) if pose is None else pose
        self._begin(velocity)

    def _begin(self, velocity: Twist | None) -> None:
        """Forget the map and the motion, keep the pose."""
        self._maps = MapsByClock(self._pose, velocity)
        self._velocity: Twist | None = None
        self._registered_ns: int | None = None
        self._previous: PointGrid | None = None
        self._health = HealthMonitor()

    def anew(self, velocity: Twist | None = None) -> "_Run":
        """Begin after this one, where it ended.

        Args:
            velocity: How the sensor moves at first, per second; stands still when None.
        """
        run = _Run(self._pose, velocity)
        run.stamp_ns = self.stamp_ns
        return run

    def pose(self, frame: LidarFrame) -> PosedFrame:
        """Register one frame."""
        dt_s = 0.0 if self.stamp_ns is None else (frame.stamp_ns - self.stamp_ns) / NS_PER_S
        restarted = ""
        if self.stamp_ns is not None and not 0.0 < dt_s <= MAX_GAP_S:
            restarted = f"no frame for {dt_s:.2f} s"
            if dt_s <= 0.0:
                restarted = f"time went back by {-dt_s:.2f} s" if dt_s else "time stood still"
            self._begin(None)
        self.stamp_ns = frame.stamp_ns

        points = _usable(frame)
        predicted = self._maps.expected(frame.stamp_ns)
        problem = too_little(points)
        if problem:
            return self._unregistered(frame, predicted, problem)
        pose, keypoints = self._maps.register(points, frame.stamp_ns, self._velocity)
        if pose is None:
            self._begin(None)
            return self._unregistered(frame, predicted, "registration did not converge")

        residual_m = self._residual(keypoints, pose)
        judged = Judgement()
        if self._registered_ns is not None:
            self._velocity = twist(inverse(self._pose) @ pose) / dt_s
            judged = self._health.judge(self._velocity, dt_s, residual_m)
        self._pose, self._registered_ns = pose, frame.stamp_ns
        self._previous = build_grid(transform(pose, _structure(points)), pose[:3, 3])
        if restarted:
            judged = Judgement(OdometryState.DEGRADED, f"odometry starts anew: {restarted}")
        return PosedFrame(
            frame, pose.copy(), judged.state, residual_m, judged.reason, jumped=judged.jumped
        )

    def _unregistered(self, frame: LidarFrame, pose: Transform, problem: str) -> PosedFrame:
        """Answer with a predicted pose; believe in prediction for half a second."""
        since = self._registered_ns
        blind_s = np.inf if since is None else (frame.stamp_ns - since) / NS_PER_S
        state = OdometryState.DEGRADED
        if blind_s > MAX_GAP_S:
            state = OdometryState.LOST
            self._begin(None)
        else:
            self._pose = pose
            self._maps.believe(pose, frame.stamp_ns)
        return PosedFrame(frame, pose.copy(), state, reason=problem)

    def _residual(self, keypoints: NDArray[np.float64], pose: Transform) -> float:
        """Median distance of this frame's key points to the frame before, metres."""
        if self._previous is None:
            return float("nan")
        placed = transform(pose, _structure(keypoints))
        if len(placed) == 0:
            return float("nan")
        return float(np.median(nearest_distances(self._previous, placed, _RESIDUAL_REACH_M)))


def _usable(frame: LidarFrame) -> NDArray[np.float64]:
    points = frame.points_m[frame.valid_mask].astype(np.float64)
    squared = np.einsum("ij,ij->i", points, points)
    usable: NDArray[np.float64] = points[(squared > MIN_RANGE_M**2) & (squared < MAX_RANGE_M**2)]
    return usable


def _structure(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points off the road and near: rings on the road move with the car."""
    squared = points[:, 0] ** 2 + points[:, 1] ** 2
    return points[(points[:, 2] > -1.0) & (squared < 40.0**2)]
