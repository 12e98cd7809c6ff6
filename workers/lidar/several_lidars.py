"""Several lidars of one car: poses of their joined frames, and their points at one instant.

The pose is that of the main lidar. Points of a further lidar were measured from another place at
another time: once the poses are known, they are moved to where the main lidar would have measured
them, by the car's motion between the two. The main lidar's points stay as recorded.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import tee
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Points, Transform
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from workers.lidar.compensation import is_compensated, to_middle
from workers.lidar.deskew import Twist, deskew, motion, time_from_middle_s, twist
from workers.points.se3 import inverse, transform

MAX_STEP_S: Final = 0.5
"""Longest step between two frames whose poses give the motion within them, seconds."""

HALF_SWEEP_NS: Final = NS_PER_S // 20
"""Half of a revolution at 10 Hz, nanoseconds, where no point has a time of its own."""

_SECTORS: Final = 360
_ORIGIN: Final = np.zeros(3)


def posed_frames(
    frames: Iterable[LidarFrame],
    odometry: Callable[[Iterable[LidarFrame]], Iterator[PosedFrame]],
) -> Iterator[PosedFrame]:
    """Yield frames with the poses of their main lidar; further points are placed by them.

    A joined frame waits for the next one without an earlier pose, which gives the car's motion.
    """
    whole, alone = tee(frames)
    before: PosedFrame | None = None
    waiting: PosedFrame | None = None
    for frame, posed in zip(whole, odometry(each.main() for each in alone), strict=True):
        if not frame.joined:
            yield posed
            continue
        now = replace(posed, frame=frame)
        if waiting is not None:
            yield _placed_by(waiting, _velocity(waiting, now))
            waiting = None
        velocity = None if before is None else _velocity(before, now)
        before = now
        if velocity is None:
            waiting = now
        else:
            yield _placed_by(now, velocity)
    if waiting is not None:
        yield _placed_by(waiting, None)


def placed(frame: LidarFrame, velocity: Twist | None) -> LidarFrame:
    """Move the points of further lidars to where the main lidar would have measured them.

    A point gets the time at which the main lidar looks in its direction, so that compensation and
    clusters treat the points of all lidars alike.

    Args:
        frame: A joined frame, as read.
        velocity: Twist of the main lidar per second; None where it is unknown, so that lidars are
            placed as if the car stood.

    Returns:
        The frame, with each `main_from_lidar` between the middles of both sweeps.
    """
    main = frame.main()
    points_m, offset_ns = frame.points_m.copy(), frame.offset_ns.copy()
    middle_ns = sweep_middle_ns(main, frame.stamp_ns)
    seen_at = _Sight(main, velocity)
    lidars = []
    for number, lidar in enumerate(frame.joined):
        rows = frame.points_of(number)
        own = lidar_frame(frame, number)
        apart_s = (sweep_middle_ns(own, lidar.stamp_ns) - middle_ns) / NS_PER_S
        main_from_lidar = lidar.main_from_lidar
        if velocity is not None and lidar.points:
            of_lidar = seen_from(velocity, lidar.main_from_lidar)
            index = np.arange(len(own))
            straight = to_middle(own, own.points_m, index, of_lidar, _ORIGIN)
            main_from_lidar = motion(velocity * apart_s) @ lidar.main_from_lidar
            moved, times_s = seen_at(transform(main_from_lidar, straight))
            moved[~own.valid_mask] = 0.0
            points_m[rows] = moved
            offset_ns[rows] = middle_ns - frame.stamp_ns
            offset_ns[rows] += np.rint(times_s * NS_PER_S).astype(np.int32)
        elif lidar.points:
            offset_ns[rows] = middle_ns - frame.stamp_ns
        lidars.append(replace(lidar, main_from_lidar=main_from_lidar))
    return replace(frame, points_m=points_m, offset_ns=offset_ns, joined=tuple(lidars))


def lidar_frame(frame: LidarFrame, number: int) -> LidarFrame:
    """Return the points of one further lidar as a frame of that lidar, in its own space.

    Its stamp is that of the joined frame, from which times of points count.
    """
    lidar, part = frame.joined[number], frame.part(frame.points_of(number))
    points_m = transform(inverse(lidar.main_from_lidar), part.points_m)
    points_m[~part.valid_mask] = 0.0
    return replace(part, points_m=points_m, has_point_time=lidar.has_point_time, boxes=None)


def sweep_middle_ns(frame: LidarFrame, stamp_ns: int) -> int:
    """Return the instant to which a cloud is compensated, nanoseconds since the Unix epoch.

    It is the middle of the sweep, or the stamp of a cloud that was recorded compensated.

    Args:
        frame: The points, with times after the stamp of the frame.
        stamp_ns: Stamp of their cloud, which a further lidar has of its own.
    """
    if frame.compensated == "yes":
        return stamp_ns
    valid = frame.offset_ns[frame.valid_mask]
    if frame.has_point_time and len(valid):
        return frame.stamp_ns + (int(valid.min()) + int(valid.max())) // 2
    return stamp_ns + {"start": HALF_SWEEP_NS, "middle": 0, "end": -HALF_SWEEP_NS}[frame.stamp_at]


def seen_from(velocity: Twist, main_from_lidar: Transform) -> Twist:
    """Return the twist of a lidar that is rigid with the main one, in its own space."""
    turn, lever_m = main_from_lidar[:3, :3], main_from_lidar[:3, 3]
    moved = velocity[3:] + np.cross(velocity[:3], lever_m)
    return np.concatenate([turn.T @ velocity[:3], turn.T @ moved])


class _Sight:
    """Times at which the main lidar looks in each direction, and points as it measures them."""

    def __init__(self, main: LidarFrame, velocity: Twist | None) -> None:
        time_s = None if velocity is None else time_from_middle_s(main)
        if velocity is None or time_s is None or main.compensated == "yes":
            self._velocity = None
            return
        valid = main.valid_mask
        points_m, seen_s, ring = main.points_m[valid], time_s[valid], main.ring[valid]
        self._velocity = velocity
        if main.compensated == "auto" and is_compensated(points_m, seen_s, ring, velocity, _ORIGIN):
            self._velocity = None
            return
        sector = _sector(points_m)
        count = np.bincount(sector, minlength=_SECTORS)
        known = np.flatnonzero(count)
        mean = np.bincount(sector, seen_s, minlength=_SECTORS)[known] / count[known]
        # the nearest sector with points: a mean of two would be wrong where a sweep begins
        apart = np.abs((np.arange(_SECTORS)[:, None] - known + _SECTORS // 2) % _SECTORS - 180)
        self._time_s = mean[apart.argmin(axis=1)].astype(np.float32)

    def __call__(self, points_m: Points) -> tuple[Points, NDArray[np.float32]]:
        """Return (N, 3) points as measured, and their (N,) times after the middle, seconds.

        Args:
            points_m: (N, 3) in the main lidar's space of the middle of its sweep.
        """
        if self._velocity is None:
            return points_m, np.zeros(len(points_m), np.float32)
        time_s = self._time_s[_sector(points_m)]
        return deskew(points_m, time_s, -self._velocity), time_s


def _sector(points_m: Points) -> NDArray[np.int64]:
    azimuth = np.arctan2(points_m[:, 1], points_m[:, 0])
    return np.floor((azimuth + np.pi) * (_SECTORS / (2 * np.pi))).astype(np.int64) % _SECTORS


def _placed_by(posed: PosedFrame, velocity: Twist | None) -> PosedFrame:
    return replace(posed, frame=placed(posed.frame, velocity))


def _velocity(before: PosedFrame, after: PosedFrame) -> Twist | None:
    """Return the twist of the main lidar per second; None where the poses do not give it."""
    step_s = (after.frame.stamp_ns - before.frame.stamp_ns) / NS_PER_S
    states = (before.odometry, after.odometry)
    if not 0.0 < step_s <= MAX_STEP_S or OdometryState.LOST in states or after.jumped:
        return None
    velocity: Twist = twist(inverse(before.odom_from_sensor) @ after.odom_from_sensor) / step_s
    return velocity
