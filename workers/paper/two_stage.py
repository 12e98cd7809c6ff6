"""Two-stage stream of the paper by flow name: scene flow, ego compensation, clustering."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Flow, Points
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from schemas.labels import Blindness, FrameHealth, FrameLabels, MotionLabel
from schemas.motion_rule import PER_SECOND, MotionRule
from schemas.task import MOTION, Task
from workers.lidar.preprocessing import PreprocessedFrame, Preprocessor
from workers.paper.object_flow import object_flow
from workers.paper.scene_flow import SceneFlowSource
from workers.paper.two_stage_clustering import two_stage
from workers.part_version import version_of
from workers.points.se3 import transform
from workers.selfsupervised.history import MAX_GAP_NS
from workers.selfsupervised.labelling import ALONE, GROUND, unknown_labels


@dataclass(frozen=True, slots=True)
class TwoStage:
    """Labels each frame by the flow from it to the frame before, without delay.

    The published chain uses the next frame instead. Its rule needs flow that is accurate to a
    centimetre per frame, and finds almost nothing with simple flows.

    Attributes:
        flow: Name of the scene flow.
        source: The scene flow itself.
        rule: Numbers of the clustering.
        weights: Version of the weights of a learned flow; empty: it has none.
    """

    flow: str
    source: SceneFlowSource
    rule: MotionRule = PER_SECOND
    weights: str = ""
    task: ClassVar[Task] = MOTION

    @property
    def version(self) -> str:
        """`two-stage@digest` of code, libraries, flow with its weights, and rule."""
        return version_of("two-stage", f"{self.flow} {self.rule} {self.weights}")

    @property
    def class_names(self) -> tuple[str, ...]:
        """The stream has no classes."""
        return ()

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame."""
        prepare = Preprocessor()
        before: tuple[int, PreprocessedFrame] | None = None
        for posed in frames:
            frame = posed.frame
            prepared = prepare(frame, posed.odom_from_sensor, None)
            if prepared is None:
                before = None
                yield unknown_labels(frame, health=prepare.problem(frame))
                continue
            if posed.odometry is OdometryState.LOST:
                before = None
                lost = FrameHealth(Blindness.NO_POSE, f"odometry lost: {posed.reason}")
                yield unknown_labels(frame, prepared, health=lost)
                continue
            if before is None or not 0 < frame.stamp_ns - before[0] <= MAX_GAP_NS:
                first = FrameHealth(Blindness.NO_PAST, "no frame before it to compare with")
                yield unknown_labels(frame, prepared, health=first)
            else:
                moved = flow_between(prepared, before[1], self.source)
                found = two_stage(
                    moved.places_m,
                    moved.flow_m,
                    dt_s=(frame.stamp_ns - before[0]) / NS_PER_S,
                    rule=self.rule,
                    weights=moved.weights,
                )
                yield _labels(frame, prepared, found.dynamic[prepared.voxels.of_point])
            before = (frame.stamp_ns, prepared)


@dataclass(frozen=True, slots=True, eq=False)
class FrameFlow:
    """Object flow of the voxels of one frame.

    Attributes:
        places_m: (V, 3) voxels off the ground, about the beams' origin, metres.
        flow_m: (V, 3) displacement to the other frame without ego-motion, metres.
        weights: (V,) points of each voxel.
    """

    places_m: Points
    flow_m: Flow
    weights: NDArray[np.int64]


def flow_between(
    this: PreprocessedFrame, other: PreprocessedFrame, source: SceneFlowSource
) -> FrameFlow:
    """Compute the flow of a frame's voxels to another frame, and remove ego-motion from it."""
    places = _in_beams(this)
    other_from_this = other.beams_from_odom @ this.odom_from_beams
    flow = object_flow(source(places, _in_beams(other), other_from_this), places, other_from_this)
    return FrameFlow(places, flow, np.bincount(this.voxels.of_point, minlength=len(places)))


def _in_beams(prepared: PreprocessedFrame) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return transform(prepared.beams_from_odom, prepared.voxels.centroids_m)


def _labels(
    frame: LidarFrame,
    prepared: PreprocessedFrame,
    dynamic: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
) -> FrameLabels:
    labels = np.full(len(frame), MotionLabel.UNKNOWN, np.uint8)
    confidence = np.zeros(len(frame), np.float16)
    ground_index = prepared.valid_index[prepared.ground]
    judged_index = prepared.valid_index[prepared.judged_index]
    labels[ground_index], confidence[ground_index] = MotionLabel.STATIC, GROUND
    labels[judged_index] = np.where(dynamic, MotionLabel.DYNAMIC, MotionLabel.STATIC)
    confidence[judged_index] = ALONE
    ground_mask = np.zeros(len(frame), np.bool_)
    ground_mask[ground_index] = True
    return FrameLabels(labels=labels, confidence=confidence, ground_mask=ground_mask)
