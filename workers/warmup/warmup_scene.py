"""Warm-up scene: a street of a few walls and a passing car, enough to call every loop once."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame

_FRAMES: Final = 9
_PERIOD_NS: Final = NS_PER_S // 10
_HEIGHT_M: Final = 1.8
_WALL_M: Final = 14.0
_FARTHEST_M: Final = 60.0
_SPEED_M_PER_S: Final = 8.0
_CAR_M: Final = np.array([4.5, 1.8, 1.5])
_ELEVATIONS: Final = np.radians(np.arange(-16.0, 6.0, 0.8))
_AZIMUTHS: Final = np.radians(np.arange(-180.0, 180.0, 0.4))


def warmup_frames(*, with_beams: bool) -> Iterator[LidarFrame]:
    """Yield the frames of a sensor that is still between two walls while a car approaches.

    Args:
        with_beams: Clouds contain the beam and the time of each point.
    """
    elevation, azimuth = (
        each.ravel() for each in np.meshgrid(_ELEVATIONS, _AZIMUTHS, indexing="ij")
    )
    beam = np.repeat(np.arange(len(_ELEVATIONS), dtype=np.int16), len(_AZIMUTHS))
    direction = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=1,
    )
    for number in range(_FRAMES):
        time_s = number * _PERIOD_NS / NS_PER_S
        distance_m = _distances(direction, car_x_m=16.0 - _SPEED_M_PER_S * time_s)
        # no surface is perfectly even
        distance_m += np.random.default_rng(number).normal(0.0, 0.02, len(distance_m))
        back = distance_m < _FARTHEST_M
        n = int(back.sum())
        yield LidarFrame(
            log_id="rehearsal",
            stamp_ns=NS_PER_S + number * _PERIOD_NS,
            points_m=(direction[back] * distance_m[back, None]).astype(np.float32),
            intensity=np.zeros(n, np.float32),
            offset_ns=((azimuth[back] / (2 * np.pi) + 0.5) * (_PERIOD_NS * with_beams)).astype(
                np.int32
            ),
            ring=beam[back] if with_beams else np.full(n, -1, np.int16),
            valid_mask=np.ones(n, np.bool_),
            has_point_time=with_beams,
        )


def _distances(direction: NDArray[np.float64], *, car_x_m: float) -> NDArray[np.float64]:
    """Compute the range of each beam to the road, the walls and a car, over the road's middle."""
    with np.errstate(divide="ignore", invalid="ignore"):
        road = np.where(direction[:, 2] < 0.0, -_HEIGHT_M / direction[:, 2], np.inf)
        walls = np.abs(_WALL_M / direction[:, 1])
        centre = np.array([car_x_m, -4.0, _CAR_M[2] / 2 - _HEIGHT_M])
        first, second = (centre - _CAR_M / 2) / direction, (centre + _CAR_M / 2) / direction
        enter = np.minimum(first, second).max(axis=1)
        leave = np.maximum(first, second).min(axis=1)
    car = np.where((enter > 0.0) & (enter < leave), enter, np.inf)
    return np.minimum(np.minimum(road, walls), car)
