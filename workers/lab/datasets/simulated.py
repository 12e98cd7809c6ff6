"""Frames of short simulated streets with their truth, as clouds for training images."""

from functools import cache
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from schemas.arrays import NS_PER_S, Transform
from schemas.frame import LidarFrame
from workers.lab.datasets.classes import CLASS_NAMES
from workers.lab.datasets.images import Cloud
from workers.lab.evaluation.truth.class_table import SEMANTIC_KITTI as KITTI_NAMES
from workers.lab.evaluation.truth.class_table import coarse_of_names
from workers.lab.simulation.models.kinds import SEMANTIC_KITTI, StreetClass
from workers.lab.simulation.output.samples import StreetSample
from workers.lab.simulation.sensor.lidar import Lidar, SimulatedFrame
from workers.points.se3 import inverse

_START_NS: Final = 1_772_445_600 * NS_PER_S


def clouds_of(sample: StreetSample) -> list[Cloud]:
    """Convert a sample's frames to clouds; the last frame only gives the pose after the others."""
    return [_cloud(this, following, sample.lidar) for this, following in pairwise(sample.frames)]


def _cloud(this: SimulatedFrame, following: SimulatedFrame, lidar: Lidar) -> Cloud:
    taught, n = taught_classes(), len(this)
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


@cache
def taught_classes() -> NDArray[np.uint8]:
    """Return the training class of each simulated class: (256,) index in `CLASSES`, 0 for none.

    Each class maps as its class of SemanticKITTI does in the evaluation. SemanticKITTI has no class
    of loose objects, so these become `other_static`; animals and dust are not trained.
    """
    names = tuple(KITTI_NAMES[number] for number in SEMANTIC_KITTI.values())
    taught = np.zeros(256, dtype=np.uint8)
    taught[list(SEMANTIC_KITTI)] = coarse_of_names(names)
    taught[StreetClass.OBJECT] = CLASS_NAMES.index("other_static")
    return taught


def _halfway(first: Transform, second: Transform) -> Transform:
    """Return the pose at the middle of the revolution, as odometry defines it."""
    moved = inverse(first) @ second
    half = np.eye(4)
    half[:3, :3] = Rotation.from_rotvec(
        Rotation.from_matrix(moved[:3, :3]).as_rotvec() / 2
    ).as_matrix()
    half[:3, 3] = moved[:3, 3] / 2
    middle: Transform = first @ half
    return middle
