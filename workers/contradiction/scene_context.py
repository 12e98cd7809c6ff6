"""What the tracks of a scene share, worked out once."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.contradiction import Instance, Scene
from schemas.frame import OdometryState
from workers.contradiction.keyframes import Keyframes
from workers.contradiction.rising_ground import RisingGround
from workers.contradiction.temporal_context import CalledMoving, called_moving
from workers.contradiction.tracks import frame_period_s


@dataclass(frozen=True, slots=True, eq=False)
class SceneContext:
    """Where a scene is, and what is about its tracks.

    Attributes:
        turn_rad_per_s: (F,) how fast the sensor turned in each frame.
        unseen: (F,) share of what was asked about that no other frame saw.
        doubted: (F,) 1 where the pose is not healthy.
        crowd: Instances of each kind in each frame.
        called: What the supervised stream calls moving, right before and after the scene as well.
        keyframes: What stands off the ground every half second of it.
        period_s: Between its frames.
        ground: Where the ground itself rises.
    """

    turn_rad_per_s: NDArray[np.float64]
    unseen: NDArray[np.float64]
    doubted: NDArray[np.float64]
    crowd: dict[tuple[str, int], int]
    called: CalledMoving
    keyframes: Keyframes
    period_s: float
    ground: RisingGround


def scene_context_of(scene: Scene, instances: Sequence[Instance]) -> SceneContext:
    """Work out what all tracks of a scene share."""
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
    crowd: dict[tuple[str, int], int] = {}
    for instance in instances:
        key = (instance.kind.name, instance.frame_index)
        crowd[key] = crowd.get(key, 0) + 1
    return SceneContext(
        turn_rad_per_s=np.abs(turn),
        unseen=1.0 - np.nan_to_num(np.array(seen), nan=0.0),
        doubted=np.array([float(f.posed.odometry is not OdometryState.HEALTHY) for f in frames]),
        crowd=crowd,
        called=called_moving(scene),
        keyframes=Keyframes(scene),
        period_s=frame_period_s(scene),
        ground=RisingGround([frame.posed for frame in frames]),
    )
