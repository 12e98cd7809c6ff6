"""Spinning lidar model: one revolution in a simulated street, with per-point truth."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Mask, Points, Transform
from workers.lab.simulation.models.kinds import GROUND, PASSES, REFLECTIVITY, Material, StreetClass
from workers.lab.simulation.models.meshes import Mesh, box
from workers.lab.simulation.world.attitude import rotations
from workers.lab.simulation.world.ray_casting import GROUND_OWNER, Hits, MeshScene, cast
from workers.lab.simulation.world.street import Street

Floats = NDArray[np.float64]

_REFLECTIVITY: Final = REFLECTIVITY.astype(np.float32)
_PASSES: Final = PASSES.astype(np.float32)
_IS_GROUND: Final = np.array(
    [255 if c == StreetClass.NOISE else int(c in GROUND) for c in range(max(StreetClass) + 1)],
    dtype=np.uint8,
)
_DROP: Final = 0.05
"""Reflectivity of drops and dust."""

_LEAST_FACING: Final = 0.02
_CREEPING_M_PER_S: Final = 0.2
_MOVING_M_PER_S: Final = 0.5
GRID_PER_M: Final = 512
"""Steps of a position per metre: 1/512 m is far below the noise, and keeps logs small."""

UNIFORM_64: Final = tuple(np.linspace(3.0, -25.0, 64).round(4).tolist())
"""Evenly spaced beams, similar to those of an HDL-64E, degrees."""

UNEVEN_64: Final = (
    *(15.0, 11.0, 8.0, 5.0, 3.0),
    *np.linspace(2.0, -6.0, 49).round(4).tolist(),
    *(-7.0, -8.0, -9.0, -10.0, -11.0, -12.0, -13.0, -14.0, -19.0, -25.0),
)
"""Beam table of a Pandar64 (its manual), degrees: dense around the horizon, coarse elsewhere."""


@dataclass(frozen=True)
class Lidar:
    """A spinning lidar: beams fire together, column by column, clockwise from behind.

    Attributes:
        elevation_deg: Beam table, top first; `ring` counts along it.
        columns: Firings per revolution.
        period_s: Time of one revolution.
        height_m: Height above the road.
        max_range_m: Returns beyond are lost.
        noise_m: Standard deviation of the range.
        dropout_share: Share of returns lost at random.
        azimuth_deg: Azimuth offset of each beam from its column, to the left; empty where all are
            in line.
        forward_m: Offset ahead of the middle of the car.
        pitch_deg: Nose-down tilt of the sensor.
        reach_m: Range at which 63 % of the pulses return from reflectivity 0.1 at normal incidence.
        least_range_m: Smallest measured range.
        roof: Whether the car below it hides the ground.
        roof_answers: Share of the beams onto the own car that return.
        gain: Intensity of a surface of reflectivity 1 at normal incidence.
        gamma: Exponent of reflectivity in the intensity; each manufacturer compresses it
            differently.
        compensated: Whether clouds are recorded in the sensor's space of the middle of the sweep,
            which is their stamp, without a time and a beam per point.
        left_m: Offset to the left of the middle of the car.
        yaw_deg: Turn to the left.
        fov_deg: Horizontal field of view, swept once per revolution from left to right.
        phase_s: Time of the first firing of a log after that of the main lidar.
        number: Place among the lidars of the car; its noise depends on it.
        name: Name of the sensor and its mounting.
    """

    elevation_deg: tuple[float, ...] = UNEVEN_64
    columns: int = 1024
    period_s: float = 0.1
    height_m: float = 2.0
    max_range_m: float = 100.0
    noise_m: float = 0.02
    dropout_share: float = 0.005
    azimuth_deg: tuple[float, ...] = ()
    forward_m: float = 0.0
    pitch_deg: float = 0.0
    reach_m: float = 130.0
    least_range_m: float = 0.5
    roof: bool = False
    roof_answers: float = 0.12
    gain: float = 255.0
    gamma: float = 1.0
    compensated: bool = False
    left_m: float = 0.0
    yaw_deg: float = 0.0
    fov_deg: float = 360.0
    phase_s: float = 0.0
    number: int = 0
    name: str = "spinning lidar"

    @property
    def period_ns(self) -> int:
        """Nanoseconds between two frames."""
        return round(self.period_s * NS_PER_S)

    @cached_property
    def beams(self) -> Floats:
        """(C, R, 3) unit directions in sensor space, in firing order."""
        half = np.deg2rad(self.fov_deg) / 2
        turn = half - 2 * half * np.arange(self.columns) / self.columns
        elevation = np.deg2rad(np.array(self.elevation_deg))
        aside = np.deg2rad(np.array(self.azimuth_deg or [0.0] * len(elevation)))
        azimuth = turn[:, None] + aside[None]
        flat = np.cos(elevation)
        return np.stack(
            [
                flat * np.cos(azimuth),
                flat * np.sin(azimuth),
                np.broadcast_to(np.sin(elevation), azimuth.shape),
            ],
            axis=-1,
        )

    @cached_property
    def roof_range_m(self) -> NDArray[np.float32]:
        """(C * R,) range of each beam to the own car; infinite where it misses."""
        if not self.roof:
            return np.full(self.columns * len(self.elevation_deg), np.inf, dtype=np.float32)
        return _own_roof(self).ravel()


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedFrame:
    """One revolution as measured, with the truth of each point; returns only, in firing order.

    Attributes:
        index: Number of the frame in its log.
        time_s: Seconds from the start of the log to the first firing.
        points_m: (N, 3) sensor space at each point's own firing: not motion-compensated.
        intensity: (N,) 0 to 255, the scale of many drivers.
        offset_ns: (N,) time of each return after the first firing.
        ring: (N,) beam, 0 is the top one.
        class_id: (N,) `StreetClass`.
        track: (N,) index into the street's actors, -1 none.
        motion: (N,) 0 unknown (creeping, in the air, the own car), 1 static, 2 dynamic.
        ground: (N,) 1 ground, 0 not, 255 ignored.
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

    def of_points(self, kept: Mask) -> Self:
        """Keep the points where `kept`, (N,), is true."""
        names = (
            *("points_m", "intensity", "offset_ns", "ring"),
            *("class_id", "track", "motion", "ground"),
        )
        return replace(self, **{name: getattr(self, name)[kept] for name in names})


def sensor_poses(street: Street, lidar: Lidar, time_s: Floats) -> Floats:
    """Return (T, 4, 4) world from sensor at these times."""
    bodies = street.ego_bodies(time_s)
    turn = rotations(bodies[:, 3], bodies[:, 4], bodies[:, 5])
    mounted = mounting(lidar)
    poses = np.zeros((len(time_s), 4, 4))
    poses[:, :3, :3] = turn @ mounted[:3, :3]
    poses[:, :3, 3] = bodies[:, :3] + turn @ mounted[:3, 3]
    poses[:, 3, 3] = 1.0
    return poses


def mounting(lidar: Lidar) -> Transform:
    """Return (4, 4) the car's space, on the road below its middle, from that of the lidar."""
    yaw, tilt = np.deg2rad(lidar.yaw_deg), np.deg2rad(lidar.pitch_deg)
    car_from_lidar: Transform = np.eye(4)
    car_from_lidar[:3, :3] = rotations(np.asarray(yaw), np.asarray(tilt), np.zeros(()))
    car_from_lidar[:3, 3] = (lidar.forward_m, lidar.left_m, lidar.height_m)
    return car_from_lidar


def sweep(street: Street, lidar: Lidar, index: int) -> SimulatedFrame:
    """Simulate one revolution of the lidar in the street.

    The sensor and all actors move during the revolution (rolling shutter). Noise is drawn from the
    street's seed and the frame's number alone, so frames can be simulated in any order.
    """
    time_s = index * lidar.period_s + lidar.phase_s
    fraction = np.arange(lidar.columns) / lidar.columns
    poses = sensor_poses(street, lidar, time_s + fraction * lidar.period_s)
    origins = poses[:, :3, 3]
    directions = lidar.beams @ poses[:, :3, :3].transpose(0, 2, 1)
    movers = street.movers_during(time_s, time_s + lidar.period_s, within_m=lidar.max_range_m)
    hits = cast(
        street.standing_scene,
        movers,
        origins,
        directions,
        fraction,
        max_range_m=lidar.max_range_m,
    )
    _settle_on_ground(street, hits, origins, directions)
    return _measured(street, lidar, index, hits, poses, directions)


def _settle_on_ground(street: Street, hits: Hits, origins: Floats, directions: Floats) -> None:
    """Displace hits of the bare ground by its unevenness, and set its class and material."""
    index = np.flatnonzero(hits.owner == GROUND_OWNER)
    hits.owner[index] = -1
    if not len(index) or (street.road_map is None and not len(street.terrain.waves)):
        return
    column = index // directions.shape[1]
    beams, range_m = directions.reshape(-1, 3)[index], hits.range_m[index].astype(np.float64)
    x = origins[column, 0] + range_m * beams[:, 0]
    y = origins[column, 1] + range_m * beams[:, 1]
    if street.road_map is not None:
        hits.class_id[index], hits.material[index] = street.road_map.ground_at(x, y)
    hits.range_m[index] += street.terrain.shift_m(x, y, beams[:, 2], range_m).astype(np.float32)


def _measured(
    street: Street, lidar: Lidar, index: int, hits: Hits, poses: Floats, directions: Floats
) -> SimulatedFrame:
    rng = np.random.default_rng([street.seed, index, *[lidar.number] * (lidar.number > 0)])
    time_s, rows = index * lidar.period_s + lidar.phase_s, directions.shape[1]
    ends, range_m = street.weather.answer(
        hits.range_m,
        poses[:, :3, 3],
        directions,
        time_s=time_s,
        max_range_m=lidar.max_range_m,
        rng=rng,
    )
    hits.class_id[ends], hits.owner[ends] = StreetClass.NOISE, -1
    worn = np.array([actor.reflectivity for actor in street.actors] + [0.4], dtype=np.float32)
    shine = _REFLECTIVITY[hits.material]
    coloured = hits.material == Material.COLOURED
    shine[coloured] = worn[hits.owner[coloured]]
    shine[ends] = _DROP
    if lidar.roof:
        on_roof = lidar.roof_range_m < range_m
        hits.class_id[on_roof], hits.owner[on_roof] = StreetClass.EGO, -1
        range_m = np.where(on_roof, lidar.roof_range_m, range_m)
    beam = np.flatnonzero(_answered(lidar, hits, range_m, shine, rng))

    column = beam // rows
    noise = rng.standard_normal(len(beam), dtype=np.float32) * np.float32(lidar.noise_m)
    measured = range_m[beam] + noise
    points = lidar.beams.reshape(-1, 3)[beam] * measured[:, None]
    class_id, owner = hits.class_id[beam], hits.owner[beam]
    motion = np.append(_motion_of_actors(street, time_s + lidar.period_s / 2), np.uint8(1))[owner]
    motion[(class_id == StreetClass.NOISE) | (class_id == StreetClass.EGO)] = 0
    ground = _IS_GROUND[class_id]
    speckle = 1.0 + 0.1 * rng.standard_normal(len(beam), dtype=np.float32)
    value = lidar.gain * shine[beam] ** np.float32(lidar.gamma)
    value *= speckle * (0.35 + 0.65 * hits.facing[beam])
    return SimulatedFrame(
        index=index,
        time_s=time_s,
        points_m=(np.round(points * GRID_PER_M) / GRID_PER_M).astype(np.float32),
        intensity=np.clip(np.round(value), 0, 255).astype(np.float32),
        offset_ns=(column * (lidar.period_ns // lidar.columns)).astype(np.uint32),
        ring=(beam % rows).astype(np.uint16),
        class_id=class_id,
        track=owner.astype(np.int16),
        motion=motion,
        ground=ground,
        world_from_sensor=poses[0],
    )


def _answered(
    lidar: Lidar,
    hits: Hits,
    range_m: NDArray[np.float32],
    shine: NDArray[np.float32],
    rng: np.random.Generator,
) -> Mask:
    """Test which beams return: losses by range, reflectivity, incidence, panes, and at random."""
    facing = np.sqrt(np.maximum(hits.facing, np.float32(_LEAST_FACING)))
    signal = 10.0 * shine * facing * np.sqrt(facing)
    signal *= (np.float32(lidar.reach_m) / np.maximum(range_m, np.float32(1.0))) ** 2
    share = np.exp(-signal)
    np.maximum(share, np.float32(lidar.dropout_share), out=share)
    share = 1.0 - (1.0 - share) * (1.0 - _PASSES[hits.material])
    share[hits.class_id == StreetClass.NOISE] = 0.0
    if lidar.roof:
        share[hits.class_id == StreetClass.EGO] = 1.0 - lidar.roof_answers
    share[(range_m >= lidar.max_range_m) | (range_m <= lidar.least_range_m)] = 1.0
    answered: Mask = rng.random(len(range_m), dtype=np.float32) >= share
    return answered


def _motion_of_actors(street: Street, time_s: float) -> NDArray[np.uint8]:
    speed = np.hypot(*street.actor_velocities(time_s).T)
    motion = np.where(speed > _MOVING_M_PER_S, 2, np.where(speed > _CREEPING_M_PER_S, 0, 1))
    return motion.astype(np.uint8)


def _own_roof(lidar: Lidar) -> NDArray[np.float32]:
    """Cast every beam once at the own car, which is rigid with the sensor."""
    roof_m = lidar.height_m - 0.42
    parts = [
        box(
            2.3, 1.45, roof_m - 0.5, roof_m, what=StreetClass.EGO, material=Material.METAL, x_m=0.3
        ),
        box(4.7, 1.85, 0.4, 1.0, what=StreetClass.EGO, material=Material.METAL),
    ]
    mesh = Mesh.merged(parts).placed(-lidar.forward_m, 0.0, -lidar.height_m)
    beams = lidar.beams.reshape(-1, 3).astype(np.float32)
    range_m, _, _ = MeshScene(mesh).cast(
        np.zeros_like(beams), beams, np.full(len(beams), 20.0, np.float32)
    )
    return range_m
