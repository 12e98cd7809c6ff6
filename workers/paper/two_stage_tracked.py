"""Two-stage rule on the tracked velocities of the default stream: an upper bound of the rule."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import tee
from typing import ClassVar

import numpy as np

from schemas.arrays import NS_PER_S
from schemas.frame import PosedFrame
from schemas.labels import FrameLabels, MotionLabel
from schemas.motion_rule import PER_SECOND, MotionRule
from schemas.task import MOTION, Task
from workers.paper.two_stage_clustering import two_stage
from workers.part_version import version_of
from workers.points.se3 import transform
from workers.points.voxels import voxelize
from workers.selfsupervised.labelling import ALONE
from workers.selfsupervised.stream import Registration


@dataclass(frozen=True, slots=True)
class TrackedTwoStage:
    """Labels a point dynamic where both the default stream and the two-stage rule do.

    Its flow is verified by free space over half a second, smoothed by the tracker, and exactly zero
    for all other points. The remaining misses are due to the rule alone.

    Attributes:
        rule: Thresholds of the clustering.
    """

    rule: MotionRule = PER_SECOND
    task: ClassVar[Task] = MOTION

    @property
    def version(self) -> str:
        """`two-stage@digest` of code, libraries and rule."""
        return version_of("two-stage", f"tracked {self.rule}")

    @property
    def class_names(self) -> tuple[str, ...]:
        """The stream has no classes."""
        return ()

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame."""
        own, of_registration = tee(frames)
        before_ns: int | None = None
        for posed, said in zip(own, Registration()(of_registration), strict=True):
            now_ns = posed.frame.stamp_ns
            if said.health.blindness is None and before_ns is not None:
                yield _by_rule(posed, said, (now_ns - before_ns) / NS_PER_S, self.rule)
            else:
                yield replace(said, confirmed=None)
            before_ns = now_ns


def _by_rule(posed: PosedFrame, said: FrameLabels, dt_s: float, rule: MotionRule) -> FrameLabels:
    cluster, velocities = said.cluster, said.cluster_velocity_m_per_s
    if cluster is None or velocities is None or said.ground_mask is None:
        raise ValueError("the default stream tells clusters, velocities and ground")
    moves = said.labels == MotionLabel.DYNAMIC
    # ground that touches a mover has no flow of its own: to the rule it is ground
    attached = moves & (cluster < 0)
    asked = np.flatnonzero((said.labels != MotionLabel.UNKNOWN) & ~said.ground_mask & ~attached)
    places = transform(posed.odom_from_sensor, posed.frame.points_m[asked])
    voxels = voxelize(places)
    weights = np.bincount(voxels.of_point, minlength=len(voxels.centroids_m))
    # a voxel is in one cluster: any of its points gives the velocity
    some = np.zeros(len(weights), np.int64)
    some[voxels.of_point] = asked
    of_voxel = np.where(moves[some] & (cluster[some] >= 0), cluster[some], -1)
    flow_m = np.zeros((len(some), 3))
    flow_m[of_voxel >= 0] = velocities[of_voxel[of_voxel >= 0]] * dt_s
    found = two_stage(voxels.centroids_m, flow_m, dt_s=dt_s, rule=rule, weights=weights)

    labels, confidence = said.labels.copy(), said.confidence.copy()
    dynamic = found.dynamic[voxels.of_point]
    labels[attached] = MotionLabel.STATIC
    labels[asked] = np.where(dynamic, MotionLabel.DYNAMIC, MotionLabel.STATIC)
    confidence[asked] = ALONE
    return replace(said, labels=labels, confidence=confidence, confirmed=None)
