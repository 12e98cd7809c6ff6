"""Scene context: data that all tracks of a scene share, computed once."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.contradiction import Instance, Scene
from schemas.frame import OdometryState
from workers.contradiction.bled_labels import AgreedDirections
from workers.contradiction.keyframes import Keyframes
from workers.contradiction.rising_ground import RisingGround
from workers.contradiction.temporal_context import DynamicPoints, dynamic_points_of
from workers.contradiction.tracks import frame_period_s


@dataclass(frozen=True, slots=True, eq=False)
class SceneContext:
    """Ego-motion, observation and surroundings of a scene.

    Attributes:
        turn_rad_per_s: (F,) absolute turn rate of the sensor in each frame.
        unobserved: (F,) share of the places queried by the witness that no other frame observed.
        doubted: (F,) 1 where the pose is not healthy, else 0.
        clutter: Number of instances, by kind and frame.
        dynamic_points: Points that the supervised stream labels dynamic, from a second before the
            scene to a second after.
        keyframes: Points off the ground every half second.
        period_s: Median time between its frames.
        ground: Its rising ground.
        agreed_directions: Directions of the movers that both streams label.
    """

    turn_rad_per_s: NDArray[np.float64]
    unobserved: NDArray[np.float64]
    doubted: NDArray[np.float64]
    clutter: dict[tuple[str, int], int]
    dynamic_points: DynamicPoints
    keyframes: Keyframes
    period_s: float
    ground: RisingGround
    agreed_directions: AgreedDirections


def scene_context_of(scene: Scene, instances: Sequence[Instance]) -> SceneContext:
    """Compute the context of a scene."""
    frames = scene.frames
    poses = np.stack([frame.posed.odom_from_sensor for frame in frames])
    heading = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    stamps_s = np.array([(frame.stamp_ns - scene.start_ns) / NS_PER_S for frame in frames])
    turn = np.zeros(len(frames))
    if len(frames) > 1 and (np.diff(stamps_s) > 0).all():  # where time stands, no rate is known
        turn = np.gradient(heading, stamps_s)
    seen = [
        frame.witness.health.seen_share if frame.witness is not None else math.nan
        for frame in frames
    ]
    clutter: dict[tuple[str, int], int] = {}
    for instance in instances:
        key = (instance.kind.name, instance.frame_index)
        clutter[key] = clutter.get(key, 0) + 1
    return SceneContext(
        turn_rad_per_s=np.abs(turn),
        unobserved=1.0 - np.nan_to_num(np.array(seen), nan=0.0),
        doubted=np.array([float(f.posed.odometry is not OdometryState.HEALTHY) for f in frames]),
        clutter=clutter,
        dynamic_points=dynamic_points_of(scene),
        keyframes=Keyframes(scene),
        period_s=frame_period_s(scene),
        ground=RisingGround([frame.posed for frame in frames]),
        agreed_directions=AgreedDirections(frames),
    )
