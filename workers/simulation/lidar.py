"""A spinning lidar in a simulated street: one revolution, point by point, with its truth."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Points, Transform
from workers.simulation.cast import GROUND_HIT, NOTHING_HIT, cast
from workers.simulation.kinds import GROUND, REFLECTIVITY, StreetClass
from workers.simulation.street import Street

_CREEPING_M_PER_S: Final = 0.2
_MOVING_M_PER_S: Final = 0.5
_REFLECTIVITY: Final = np.array([0.0, *(REFLECTIVITY[c] for c in StreetClass)])
_GRID_PER_M: Final = 512
"""Positions are rounded to 1/512 m, far below the noise: it is what makes logs small."""

UNIFORM_64: Final = tuple(np.linspace(3.0, -25.0, 64).round(4).tolist())
"""Evenly spaced beams, about those of an HDL-64E."""

UNEVEN_64: Final = (
    *(15.0, 11.0, 8.0, 5.0, 3.0),
    *np.linspace(2.0, -6.0, 49).round(4).tolist(),
    *(-7.0, -8.0, -9.0, -10.0, -11.0, -12.0, -13.0, -14.0, -19.0, -25.0),
)
"""Dense around the horizon, coarse above and below: the layout of a Pandar64 (its manual)."""


@dataclass(frozen=True, slots=True)
class Lidar:
    """A spinning lidar: beams fire together, column by column, clockwise from behind.

    Attributes:
        elevation_deg: Beam table, top first; `ring` counts along it.
        columns: Firings per revolution.
        period_s: Time of one revolution.
        height_m: Above the road.
        max_range_m: Returns beyond are lost.
        noise_m: Standard deviation of the range.
        dropout_share: Returns lost for no reason.
    """

    elevation_deg: tuple[float, ...] = UNEVEN_64
    columns: int = 1024
    period_s: float = 0.1
    height_m: float = 2.0
    max_range_m: float = 100.0
    noise_m: float = 0.02
    dropout_share: float = 0.01

    @property
    def period_ns(self) -> int:
        """Nanoseconds between two frames."""
        return round(self.period_s * NS_PER_S)


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedFrame:
    """One revolution as measured, and what each point really is; returns only, in firing order.

    Attributes:
        index: Number of the frame in its log.
        time_s: Seconds from the start of the log to the first firing.
        points_m: (N, 3) sensor space of each point's own firing instant: not compensated.
        intensity: (N,) 0 to 255, as many drivers record it.
        offset_ns: (N,) time of each return after the first firing.
        ring: (N,) beam, 0 is the top one.
        class_id: (N,) `StreetClass`.
        track: (N,) index into the street's actors, -1 none.
        motion: (N,) 0 unknown (creeping), 1 static, 2 dynamic.
        ground: (N,) 1 ground, 0 not.
        world_from_sensor: (4, 4) pose at the first firing.
    """

    index: int
    time_s: float
    points_m: Points
    intensity: NDArray[np.float32]
    offset_ns: NDArray[np.uint32]
    ring: NDArray[np.uint16]
    class_id: NDArray[np.uint8]
    track: NDArray[np.int16]
    motion: NDArray[np.uint8]
    ground: NDArray[np.uint8]
    world_from_sensor: Transform = field(repr=False)

    def __len__(self) -> int:
        """Count the returns."""
        return len(self.points_m)


def sweep(street: Street, lidar: Lidar, index: int) -> SimulatedFrame:
    """Turn the lidar once in the street.

    The sensor and everything that moves go on moving while it turns (rolling shutter). Noise is
    drawn from the street's seed and the frame's number alone, so frames can be made in any order.
    """
    time_s = index * lidar.period_s
    fraction = np.arange(lidar.columns) / lidar.columns
    azimuth = np.pi - 2 * np.pi * fraction
    elevation = np.deg2rad(np.array(lidar.elevation_deg))
    ego = street.ego.pose(time_s + fraction * lidar.period_s)
    start, end, shapes = street.shapes_during(
        time_s, time_s + lidar.period_s, within_m=lidar.max_range_m
    )
    range_m, hit = cast(
        ego,
        azimuth,
        fraction,
        np.tan(elevation),
        lidar.height_m,
        start,
        end,
        shapes.form,
        street.road_waves,
    )
    range_m = range_m / np.cos(elevation)[None, :]
    shape_class = np.append(shapes.class_id, [StreetClass.ROAD, 0])  # -2 ground, -1 nothing
    shape_owner = np.append(shapes.owner, [-1, -1])
    class_id, owner = shape_class[hit], shape_owner[hit]

    rng = np.random.default_rng([street.seed, index])
    measured, keep = _measure(range_m, hit, class_id, elevation, lidar, rng)
    column, ring = np.nonzero(keep)
    r, a, e = measured[keep], azimuth[column], elevation[ring]
    points = np.stack([r * np.cos(e) * np.cos(a), r * np.cos(e) * np.sin(a), r * np.sin(e)], axis=1)
    kept_class, kept_owner = class_id[keep], owner[keep]
    motion = np.append(_motion_of_actors(street, time_s + lidar.period_s / 2), np.uint8(1))
    return SimulatedFrame(
        index=index,
        time_s=time_s,
        points_m=(np.round(points * _GRID_PER_M) / _GRID_PER_M).astype(np.float32),
        intensity=_intensity(kept_class, r, rng),
        offset_ns=(column * (lidar.period_ns // lidar.columns)).astype(np.uint32),
        ring=ring.astype(np.uint16),
        class_id=kept_class.astype(np.uint8),
        track=kept_owner.astype(np.int16),
        motion=motion[kept_owner],
        ground=np.isin(kept_class, GROUND).astype(np.uint8),
        world_from_sensor=_transform(ego[0], lidar.height_m),
    )


def _measure(
    range_m: NDArray[np.float64],
    hit: NDArray[np.int32],
    class_id: NDArray[np.int64],
    elevation: NDArray[np.float64],
    lidar: Lidar,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Blur ranges and lose returns as a lidar does: far, dark, at a grazing angle, in leaves."""
    lift = np.where(hit == GROUND_HIT, np.abs(np.sin(elevation))[None, :], 1.0)
    signal = _REFLECTIVITY[class_id] * lift * (120.0 / np.maximum(range_m, 1.0)) ** 2
    lost = rng.random(range_m.shape) < np.maximum(lidar.dropout_share, np.exp(-2.0 * signal))
    leaves = class_id == StreetClass.VEGETATION
    noise = rng.normal(0.0, lidar.noise_m, range_m.shape)
    noise[leaves] += rng.random(int(leaves.sum())) * 0.5
    keep = (hit != NOTHING_HIT) & ~lost & (range_m < lidar.max_range_m)
    return range_m + noise, keep


def _intensity(
    class_id: NDArray[np.int64], range_m: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float32]:
    value = 255 * _REFLECTIVITY[class_id] * rng.normal(1.0, 0.1, len(class_id))
    return np.clip(np.round(value), 0, 255).astype(np.float32)


def _motion_of_actors(street: Street, time_s: float) -> NDArray[np.uint8]:
    speed = np.hypot(*street.actor_velocities(time_s).T)
    motion = np.where(speed > _MOVING_M_PER_S, 2, np.where(speed > _CREEPING_M_PER_S, 0, 1))
    return motion.astype(np.uint8)


def _transform(pose: NDArray[np.float64], height_m: float) -> Transform:
    x, y, yaw = pose
    transform = np.eye(4)
    transform[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    transform[:3, 3] = [x, y, height_m]
    return transform
