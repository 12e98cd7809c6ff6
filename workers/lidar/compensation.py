"""Compensation: clouds to the middle of their sweep, and clouds that already were compensated.

A spinning lidar fires at an even rate: seen from where its beams meet, the azimuth of its points is
linear in their times. After compensation it is not, until the motion is put back.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from schemas.frame import LidarFrame
from workers.lidar.deskew import Twist, deskew, time_from_middle_s

_REACH_M: Final = 25.0
"""Range up to which motion within a sweep turns directions clearly: 0.5 m are a degree there."""

_NEAREST_M: Final = 3.0
_SAMPLES: Final = 3000
_FEWEST: Final = 300
_FEWEST_OF_BEAM: Final = 5
_CLEAR_RAD: Final = 0.002
"""Least gain in azimuth that decides, radians: 0.5 m/s at 10 m; less bends a cloud by 2 cm."""

_CLEAR_SHARE: Final = 0.6


def to_middle(
    frame: LidarFrame,
    points_m: Points,
    index: NDArray[np.int64],
    velocity: Twist | None,
    origin_m: NDArray[np.floating],
) -> Points:
    """Bring points to the middle of their sweep, unless they were compensated before recording.

    Args:
        frame: Their frame, with the time of each point.
        points_m: (M, 3) some of its points, sensor space.
        index: (M,) indices of these points in the frame, rising.
        velocity: Twist of the sensor per second; None when unknown.
        origin_m: (3,) where the beams meet, sensor space.

    Returns:
        (M, 3); the same points where times or velocity are unknown.
    """
    time_s = None if velocity is None else time_from_middle_s(frame)
    if velocity is None or time_s is None or frame.compensated == "yes":
        return points_m
    time_s = time_s[index]
    if frame.compensated == "auto":
        main = np.searchsorted(index, frame.main_points)  # further lidars turn for themselves
        rings = frame.ring[index[:main]]
        if is_compensated(points_m[:main], time_s[:main], rings, velocity, origin_m):
            return points_m
    return deskew(points_m, time_s, velocity)


def is_compensated(
    points_m: Points,
    time_s: NDArray[np.float32],
    ring: NDArray[np.int16],
    velocity: Twist,
    origin_m: NDArray[np.floating],
) -> bool:
    """Return True if points fit an even turn clearly better with the car's motion put back.

    It needs motion, near points, and beams that are recorded or fire in line; False otherwise.

    Args:
        points_m: (M, 3) sensor space.
        time_s: (M,) from the middle of the sweep.
        ring: (M,) beam of each, -1 where not recorded.
        velocity: Twist of the sensor per second.
        origin_m: (3,) where the beams meet, sensor space.
    """
    if not _bends(velocity, time_s):
        return False
    # an odd step meets every beam of a cloud that is stored column by column
    chosen = slice(None, None, len(points_m) // _SAMPLES | 1)
    points, time, ring = points_m[chosen], time_s[chosen], ring[chosen]
    range_m = np.hypot(points[:, 0], points[:, 1])
    near = (range_m > _NEAREST_M) & (range_m < _REACH_M)
    points, time, ring = points[near], time[near], ring[near]
    if len(points) < _FEWEST:
        return False
    about = origin_m.astype(np.float32)
    recorded = _unevenness_rad(points - about, time, ring)
    if recorded <= _CLEAR_RAD:
        return False
    put_back = min(
        _unevenness_rad(deskew(points, time - instant, -velocity) - about, time, ring)
        for instant in (time.min(), np.float32(0.0), time.max())
    )
    return put_back < _CLEAR_SHARE * recorded and put_back < recorded - _CLEAR_RAD


def _bends(velocity: Twist, time_s: NDArray[np.float32]) -> bool:
    """Return True if the motion within the sweep is large enough to see."""
    if len(time_s) == 0:
        return False
    span_s = float(time_s.max() - time_s.min())
    turned = float(np.linalg.norm(velocity[:3])) * span_s
    moved = float(np.linalg.norm(velocity[3:])) * span_s
    return turned + moved / 10.0 > 4.0 * _CLEAR_RAD


def _unevenness_rad(about_m: Points, time_s: NDArray[np.float32], ring: NDArray[np.int16]) -> float:
    """Return the median deviation of azimuths from an even turn, with an offset for each beam."""
    azimuth = np.arctan2(about_m[:, 1], about_m[:, 0])
    turn = 2.0 * np.pi / float(time_s.max() - time_s.min()) * time_s
    sums = [np.exp(1j * (azimuth - turns * turn)).mean() for turns in (1.0, -1.0)]
    turns, middle = max(zip((1.0, -1.0), sums, strict=True), key=lambda each: abs(each[1]))
    phase = np.angle(np.exp(1j * (azimuth - turns * turn)) * np.conj(middle))
    of_beam = ring.astype(np.int64) - int(ring.min())
    count = np.maximum(np.bincount(of_beam), 1)
    x = time_s - (np.bincount(of_beam, time_s) / count)[of_beam]
    y = phase - (np.bincount(of_beam, phase) / count)[of_beam]
    enough = count[of_beam] >= _FEWEST_OF_BEAM
    if not enough.any():
        return 0.0
    x, y = x[enough], y[enough]
    slope = float(x @ y) / max(float(x @ x), 1e-12)
    return float(np.median(np.abs(y - slope * x)))
