"""Where the sensor was at each frame, and whether that may be believed: KISS-ICP under guard."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Mask, Points, Transform
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from workers.geometry.se3 import inverse, transform
from workers.selfsupervised.beginning import contradicted_share, likely_velocities
from workers.selfsupervised.health import HealthMonitor, Judgement, too_little
from workers.selfsupervised.kiss_map import MAX_RANGE_M
from workers.selfsupervised.maps_by_clock import MapsByClock
from workers.selfsupervised.neighbours import PointGrid, build_grid, nearest_distances
from workers.selfsupervised.versions import version_of
from workers.visibility.compiled import compiled
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

_ALIKE: Final = 1.25
"""What free space contradicts no more than by this factor may be the truth as well: on a motorway
full of cars that drive along standing still was contradicted .12, the true speed .14, and a second
later .11 and .09."""

_AGAIN_S: Final = 1.0
_LOOKS: Final = 5
"""So often; what is not clear by then, as among cars that drive along all around, is believed."""


class KissOdometry:
    """KISS-ICP (`kiss_map.py`) on maps that begin by the clock (`maps_by_clock.py`).

    No frame is ever refused: one that cannot be registered gets the predicted pose and says so.

    The first frames of a stretch are held back for a third of a second. KISS-ICP starts from no
    motion, and between rails and noise walls 2 m a frame fit as well without moving: every speed
    that the first two frames allow is tried beside it, and the one kept that free space contradicts
    least. Where another one is contradicted hardly more, poses are doubted, and both are looked at
    again each second, until one is clearly better, five times at most.

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
        unsure: _Unsure | None = None
        for frame in frames:
            if not _follows(held[-1].stamp_ns if held else run.stamp_ns, frame):
                if held:
                    run, posed, unsure = _begin(run, held)
                    yield from posed
                held, begun = [], False
            if begun:
                now = run.pose(frame)
                if unsure is not None:
                    run, now, unsure = unsure.look_again(run, now)
                yield now
                continue
            held.append(frame)
            if _span_s(held) >= BEGINNING_S or len(held) == _MOST_HELD:
                run, posed, unsure = _begin(run, held)
                yield from posed
                held, begun = [], True
        if held:
            yield from _begin(run, held)[1]


def _begin(
    before: "_Run", held: Sequence[LidarFrame]
) -> tuple["_Run", list[PosedFrame], "_Unsure | None"]:
    """Register the first frames of a stretch; from no motion, unless another start is better."""
    run = before.anew()
    posed = [run.pose(frame) for frame in held]
    if len(held) < _FEWEST_HELD:
        return run, posed, None
    found = _likeliest(run, posed, before.anew)
    if not found.alike:
        return found.run, found.posed, None
    return found.run, [_doubted(each, found.alike) for each in found.posed], _Unsure(found)


@dataclass(frozen=True, slots=True, eq=False)
class _Likeliest:
    """How the sensor moves, as far as a few frames tell.

    Attributes:
        run: The run that goes on from there.
        posed: The frames as it poses them.
        alike: What else may be, in words; empty where it is clear.
    """

    run: "_Run"
    posed: list[PosedFrame]
    alike: str = ""


def _likeliest(
    run: "_Run", posed: list[PosedFrame], begin: Callable[[Twist], "_Run"]
) -> _Likeliest:
    """Try every motion that two frames allow beside the one that is believed.

    Args:
        run: The run that posed the frames.
        posed: Frames in a row.
        begin: Begins another run before the first of them, with a motion per second.
    """
    frames = [each.frame for each in posed]
    dt_s, first_m, moved_m = _span_s(frames[:2]), _moved_m(posed[:2]), _moved_m(posed)
    ways = [(float("nan"), run, posed)]
    for velocity in likely_velocities(frames[0], frames[1]):
        if np.linalg.norm(velocity[3:] * dt_s - first_m) < _ANOTHER_M:
            continue
        other = begin(velocity)
        posed_so = [other.pose(frame) for frame in frames]
        if np.linalg.norm(_moved_m(posed_so) - moved_m) < _ANOTHER_M:
            continue
        if len(ways) == 1:
            ways[0] = (contradicted_share(posed), run, posed)
        ways.append((contradicted_share(posed_so), other, posed_so))
    best = ways[0]
    for way in ways[1:]:
        if way[0] < _BETTER * best[0]:
            best = way
    moved_m = _moved_m(best[2])
    for share_so, _, posed_so in ways:
        apart = float(np.linalg.norm(_moved_m(posed_so) - moved_m)) >= _ANOTHER_M
        if apart and share_so <= _ALIKE * best[0]:
            speed = float(np.linalg.norm(_moved_m(posed_so))) / _span_s(frames)
            return _Likeliest(best[1], best[2], f"{speed:.0f} m/s would fit alike")
    return _Likeliest(best[1], best[2])


class _Unsure:
    """A stretch of which it is not clear yet how the sensor moves: it is looked at each second."""

    def __init__(self, found: _Likeliest, *, looks: int = _LOOKS) -> None:
        """Begin after its first frames.

        Args:
            found: How the sensor seems to move, and what else may be.
            looks: How often it is looked at again.
        """
        self._posed = list(found.posed)
        self._looks = looks
        self._asked_ns = found.posed[-1].frame.stamp_ns
        self._alike = found.alike

    def look_again(
        self, run: "_Run", now: PosedFrame
    ) -> tuple["_Run", PosedFrame, "_Unsure | None"]:
        """Doubt a pose, or once a second say how the sensor moves.

        Args:
            run: That posed it.
            now: The frame.

        Returns:
            The run that goes on, the frame as it is posed, and whether that is still not clear.
        """
        self._posed.append(now)
        since_s = (now.frame.stamp_ns - self._asked_ns) / NS_PER_S
        if since_s < _AGAIN_S:
            return run, _doubted(now, self._alike), self
        last = [
            each
            for each in self._posed
            if now.frame.stamp_ns - each.frame.stamp_ns <= (BEGINNING_S + 0.1) * NS_PER_S
        ]
        if len(last) < _FEWEST_HELD:
            return run, now, None
        begins = last[0].odom_from_sensor
        found = _likeliest(run, last, lambda velocity: _Run(begins, velocity))
        if found.run is not run:
            moved = float(np.linalg.norm(_moved_m(found.posed))) / _span_s([p.frame for p in last])
            reason = f"the sensor moves at {moved:.0f} m/s, other than was believed"
            now = replace(found.posed[-1], odometry=OdometryState.LOST, reason=reason, jumped=True)
            found = replace(found, posed=[*found.posed[:-1], now])
        if not found.alike or self._looks <= 1:
            return found.run, now, None
        return found.run, _doubted(now, found.alike), _Unsure(found, looks=self._looks - 1)


def _doubted(posed: PosedFrame, alike: str) -> PosedFrame:
    """The same pose, doubted where nothing worse is known of it."""
    if posed.odometry is not OdometryState.HEALTHY:
        return posed
    return replace(posed, odometry=OdometryState.DEGRADED, reason=alike)


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

        points = usable(frame.points_m, frame.valid_mask)
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
        self._previous = build_grid(transform(pose, structure(points)), pose[:3, 3])
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
        placed = transform(pose, structure(keypoints))
        if len(placed) == 0:
            return float("nan")
        return float(np.median(nearest_distances(self._previous, placed, _RESIDUAL_REACH_M)))


@compiled
def usable(points: Points, valid: Mask) -> Points:
    """Returns between the nearest and the farthest range that is registered, (M, 3)."""
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
    """Points off the road and near: rings on the road move with the car."""
    rows = np.empty(points.shape, points.dtype)
    count = 0
    for i in range(len(points)):
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        if points[i, 2] > -1.0 and x * x + y * y < 40.0**2:
            rows[count] = points[i]
            count += 1
    return rows[:count].copy()
