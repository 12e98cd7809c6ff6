"""Place of a scene: the recorded fixes around it, joined with its poses.

Fixes wander by metres, poses of odometry do not within a scene. The path in odom space is laid onto
the fixes, turned and shifted, so that places of tracks are known in the frame of the fixes too.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.contradiction import LabelledFrame, Scene
from schemas.frame import RecordedFix
from schemas.surroundings import (
    EARTH,
    METRES_PER_DEGREE,
    ScenePlace,
    metres_per_degree_east,
)

REACH_NS: Final = 2 * NS_PER_S
"""Time around the middle of a scene in which fixes count, and one at least must lie: as far as the
frames around the usual scene reach.
"""

LEAST_WAY_M: Final = 5.0
"""Least way for which fixes give a direction, metres: twice the error of a common receiver."""

MOST_OFF_M: Final = 3.0
"""Mean distance of the fixes from the path that is laid onto them, metres; beyond it one is wrong.
"""

Positions = NDArray[np.float64]


def scene_place(scene: Scene) -> ScenePlace | None:
    """Find the place of the sensor at the middle of a scene; None without a fix near it.

    The place is that of the receiver: the few metres between it and the lidar are not known.
    """
    frames = (*scene.before, *scene.frames, *scene.after)
    middle_ns = (_time_ns(scene.frames[0]) + _time_ns(scene.frames[-1])) // 2
    fixes = _near(frames, middle_ns)
    if not fixes:
        return None
    times = np.array([_time_ns(frame) - middle_ns for frame in frames], np.float64)
    path = np.stack([frame.posed.odom_from_sensor[:2, 3] for frame in frames])
    at = np.array([fix.time_ns - middle_ns for fix in fixes], np.float64)
    in_odom, here = _interpolated(at, times, path), _interpolated(np.zeros(1), times, path)[0]
    origin = fixes[int(np.abs(at).argmin())]
    in_frame = _metres([fix.at for fix in fixes], origin)
    turn_rad = _turn(in_odom, in_frame)
    if turn_rad is None:
        return _placed(origin, np.zeros(2), here, None, None)
    turned = _rotation(turn_rad)
    shift = (in_frame - in_odom @ turned.T).mean(axis=0) + turned @ here
    way = in_odom[-1] - in_odom[0]
    heading_rad = turn_rad + math.atan2(float(way[1]), float(way[0]))
    return _placed(origin, shift, here, turn_rad, heading_rad)


def _near(frames: tuple[LabelledFrame, ...], middle_ns: int) -> list[RecordedFix]:
    """Return the fixes near the middle, in the frame of the nearest one, by their times."""
    every = [fix for frame in frames for fix in frame.posed.frame.fixes]
    near = [fix for fix in every if abs(fix.time_ns - middle_ns) <= REACH_NS]
    if not near:
        return []
    nearest = min(near, key=lambda fix: abs(fix.time_ns - middle_ns))
    by_time = {fix.time_ns: fix for fix in near if fix.frame == nearest.frame}
    return [by_time[time_ns] for time_ns in sorted(by_time)]


def _time_ns(frame: LabelledFrame) -> int:
    """Return the time of a pose: the middle of the sweep, where points have times."""
    cloud = frame.posed.frame
    if not cloud.has_point_time or not len(cloud):
        return cloud.stamp_ns
    return cloud.stamp_ns + (int(cloud.offset_ns.min()) + int(cloud.offset_ns.max())) // 2


def _interpolated(at: Positions, times: Positions, path: Positions) -> Positions:
    """Interpolate (T, 2) positions at (F,) times; before the first and after the last they stay."""
    order = np.argsort(times, kind="stable")
    return np.stack([np.interp(at, times[order], path[order, axis]) for axis in range(2)], axis=1)


def _metres(places: list[tuple[float, float]], origin: RecordedFix) -> Positions:
    """Return (F, 2) metres east and north (or x and y) of a fix."""
    away = np.array(places, np.float64) - origin.at
    if origin.frame != EARTH:
        return away
    east = (away[:, 1] + 180.0) % 360.0 - 180.0
    return np.stack(
        [east * metres_per_degree_east(origin.at[0]), away[:, 0] * METRES_PER_DEGREE], axis=1
    )


def _turn(in_odom: Positions, in_frame: Positions) -> float | None:
    """Return the turn of odom space that lays the path onto the fixes; None where none does."""
    if len(in_odom) < 2:
        return None
    one, other = in_odom - in_odom.mean(axis=0), in_frame - in_frame.mean(axis=0)
    if math.dist(in_odom[0], in_odom[-1]) < LEAST_WAY_M:
        return None
    turn_rad = math.atan2(
        float((one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]).sum()),
        float((one * other).sum()),
    )
    off_m = np.linalg.norm(one @ _rotation(turn_rad).T - other, axis=1).mean()
    return turn_rad if off_m <= MOST_OFF_M else None


def _rotation(turn_rad: float) -> Positions:
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    return np.array([[cos, -sin], [sin, cos]])


def _placed(
    origin: RecordedFix,
    shift_m: Positions,
    here_m: Positions,
    turn_rad: float | None,
    heading_rad: float | None,
) -> ScenePlace:
    """Build the record: coordinates to a decimetre, angles to a milliradian."""
    east_m, north_m = (float(each) for each in shift_m)
    x_m, y_m = (round(float(each), 1) + 0.0 for each in here_m)
    yaw_rad, heading_rad = _wrapped(turn_rad), _wrapped(heading_rad)
    if origin.frame != EARTH:
        return ScenePlace(
            frame=origin.frame,
            x_m=round(origin.at[0] + east_m, 1) + 0.0,
            y_m=round(origin.at[1] + north_m, 1) + 0.0,
            odom_m=(x_m, y_m),
            odom_yaw_rad=yaw_rad,
            heading_rad=heading_rad,
        )
    latitude = origin.at[0] + north_m / METRES_PER_DEGREE
    longitude = origin.at[1] + east_m / metres_per_degree_east(origin.at[0])
    return ScenePlace(
        latitude_deg=round(min(max(latitude, -90.0), 90.0), 6) + 0.0,
        longitude_deg=round((longitude + 180.0) % 360.0 - 180.0, 6) + 0.0,
        odom_m=(x_m, y_m),
        odom_yaw_rad=yaw_rad,
        heading_rad=heading_rad,
    )


def _wrapped(angle_rad: float | None) -> float | None:
    if angle_rad is None:
        return None
    return round((angle_rad + math.pi) % (2.0 * math.pi) - math.pi, 3) + 0.0
