"""Frames of short simulated streets with their truth, of sensors of several kinds."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from schemas.arrays import NS_PER_S, Transform
from schemas.frame import LidarFrame
from workers.geometry.se3 import inverse
from workers.simulation.kinds import StreetClass
from workers.simulation.lidar import UNEVEN_64, UNIFORM_64, Lidar, SimulatedFrame, sweep
from workers.simulation.worlds import build_street
from workers.training.classes import CLASS_NAMES
from workers.training.images import Cloud

_CLASS_OF: Final[Mapping[StreetClass, str]] = {
    StreetClass.ROAD: "road",
    StreetClass.SIDEWALK: "sidewalk",
    StreetClass.BUILDING: "building",
    StreetClass.VEGETATION: "vegetation",
    StreetClass.TRUNK: "vegetation",
    StreetClass.POLE: "traffic_facility",
    StreetClass.OBJECT: "other_static",
    StreetClass.CAR: "car",
    StreetClass.TRUCK: "large_vehicle",
    StreetClass.PEDESTRIAN: "pedestrian",
    StreetClass.CYCLIST: "two_wheeler",
}
"""What is taught of each simulated class; what is missing is not taught."""

SENSORS: Final[Mapping[str, Lidar]] = {
    "even-64": Lidar(elevation_deg=UNIFORM_64, columns=1800, height_m=1.75),
    "uneven-64": Lidar(elevation_deg=UNEVEN_64, columns=1800),
    "even-32": Lidar(elevation_deg=tuple(np.linspace(10.67, -30.67, 32)), columns=1800),
}
"""Lidars to learn from, by name."""

_START_NS: Final = 1_772_445_600 * NS_PER_S


def street_clouds(seed: int, *, sensor: str, frames: int) -> list[Cloud]:
    """Drive through a street of its own for about a second.

    Args:
        seed: Of the street and of all noise.
        sensor: One of `SENSORS`.
        frames: How many, a tenth of a second apart.

    Returns:
        One cloud per frame.
    """
    lidar = SENSORS[sensor]
    street = build_street(seed, seconds=(frames + 2) * lidar.period_s)
    swept = [sweep(street, lidar, number) for number in range(frames + 1)]
    return [_cloud(this, following, lidar) for this, following in pairwise(swept)]


def _cloud(this: SimulatedFrame, following: SimulatedFrame, lidar: Lidar) -> Cloud:
    taught = np.zeros(256, dtype=np.uint8)
    for street_class, name in _CLASS_OF.items():
        taught[street_class] = CLASS_NAMES.index(name)
    n = len(this)
    frame = LidarFrame(
        log_id="simulated",
        stamp_ns=_START_NS + this.index * lidar.period_ns,
        points_m=this.points_m.astype(np.float32),
        intensity=np.clip(this.intensity / 255, 0, 1).astype(np.float32),
        offset_ns=this.offset_ns.astype(np.int32),
        ring=this.ring.astype(np.int16),
        valid_mask=np.ones(n, dtype=np.bool_),
        has_point_time=True,
    )
    return Cloud(
        frame,
        semantic=taught[this.class_id],
        motion=this.motion,
        world_from_sensor=_halfway(this.world_from_sensor, following.world_from_sensor),
    )


def _halfway(first: Transform, second: Transform) -> Transform:
    """Pose at the middle of the revolution, as odometry states it."""
    moved = inverse(first) @ second
    half = np.eye(4)
    half[:3, :3] = Rotation.from_rotvec(
        Rotation.from_matrix(moved[:3, :3]).as_rotvec() / 2
    ).as_matrix()
    half[:3, 3] = moved[:3, 3] / 2
    middle: Transform = first @ half
    return middle
