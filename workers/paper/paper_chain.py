"""Self-supervised stream of the paper: camera view, learned flow, two-stage clustering."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
import torch
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Mask
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from schemas.labels import Blindness, FrameHealth, FrameLabels, MotionLabel
from schemas.motion_rule import PAPER
from schemas.task import MOTION, Task
from workers.checkpoints.stored_weights import Stored
from workers.lidar.fidelity import Form
from workers.paper.camera_filter import from_flow_space, is_ahead_within
from workers.paper.flowstep3d import FlowStep3D
from workers.paper.gndnet import GndNet
from workers.paper.ground_rule import GROUND
from workers.paper.object_flow import flow_ends
from workers.paper.paper_view import Compared, PaperView
from workers.paper.two_stage_clustering import TwoStageResult, two_stage
from workers.paper.weights import FlowStep3DCard, GndNetCard, load_flowstep3d, load_gndnet
from workers.part_version import release, version_of
from workers.points.se3 import inverse
from workers.selfsupervised.history import MAX_GAP_NS
from workers.selfsupervised.labelling import ALONE


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """Flow and clusters of the compared points of one frame.

    Attributes:
        flow_m: (K, 3) float32 in the flow's space, ego-motion included.
        near: (K,) points compared after the flow: less than 25 m ahead.
        found: Clustering of the near points, in order.
    """

    flow_m: NDArray[np.float32]
    near: Mask
    found: TwoStageResult


class PaperChain:
    """GndNet, camera filter, FlowStep3D, odometry and two-stage clustering, bug-compatible.

    Source: arXiv 2407.14306, section III-B, and its published code. A frame is labelled when the
    next one arrives; the last stays unlabelled. Everything outside the camera's view, farther than
    25 m ahead, or on the ground is UNKNOWN: the paper compares about a fourteenth of a scan.

    Args:
        gndnet: Weights of GndNet.
        flowstep3d: Weights of FlowStep3D.

    Attributes:
        view: Selects the compared points of a frame.
    """

    task: ClassVar[Task] = MOTION

    def __init__(
        self, gndnet: Stored[GndNet, GndNetCard], flowstep3d: Stored[FlowStep3D, FlowStep3DCard]
    ) -> None:
        self.view = PaperView(gndnet)
        self._flowstep3d = flowstep3d
        self._weights = f"{gndnet.digest} {flowstep3d.digest}"

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Load both networks from a folder of imported weights.

        Raises:
            WeightsUnusableError: If one is missing or damaged.
        """
        return cls(
            load_gndnet(folder / "gndnet.safetensors", form=Form.PAPER),
            load_flowstep3d(folder / "flowstep3d.safetensors", form=Form.PAPER),
        )

    @property
    def version(self) -> str:
        """`paper@digest` of code, libraries and weights."""
        return version_of("paper", f"{self._weights} torch=={release('torch')}")

    @property
    def class_names(self) -> tuple[str, ...]:
        """The stream has no classes."""
        return ()

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame, in order, once the next one has arrived.

        Raises:
            NoCameraError: If a frame has no camera's calibration.
        """
        torch.set_num_threads(1)  # a worker owns one core, and sums keep their order
        before: tuple[PosedFrame, Compared] | None = None
        for posed in frames:
            seen = self.view.compared(posed.frame)
            if before is not None:
                yield self._label(*before, posed, seen)
            before = posed, seen
        if before is not None:
            last = FrameHealth(Blindness.NO_PAST, "no frame after it to compare with")
            yield _labels(before[0].frame, before[1], None, last)

    def chain(self, this: PosedFrame, seen: Compared, other: PosedFrame, after: Compared) -> Chain:
        """Estimate the flow of the compared points to the next frame, and cluster the moving ones.

        Args:
            this: The frame.
            seen: Its compared points.
            other: The next frame.
            after: The compared points of the next frame.
        """
        card = self._flowstep3d.card
        with torch.inference_mode():
            flow_m: NDArray[np.float32] = self._flowstep3d.net(
                torch.from_numpy(seen.flow_points_m)[None],
                torch.from_numpy(after.flow_points_m)[None],
                iterates=card.iterates,
            )[-1][0].numpy()
        this_from_other = inverse(this.odom_from_sensor) @ other.odom_from_sensor
        ends_m = flow_ends(seen.flow_points_m, flow_m, seen.calibration, this_from_other)
        points_m = from_flow_space(seen.flow_points_m, seen.calibration).astype(np.float32)
        near = is_ahead_within(points_m)  # there and back again, as published
        found = two_stage(
            points_m[near],
            (ends_m - points_m)[near],
            dt_s=(other.frame.stamp_ns - this.frame.stamp_ns) / NS_PER_S,
            rule=PAPER,
        )
        return Chain(flow_m, near, found)

    def _label(
        self, this: PosedFrame, seen: Compared, other: PosedFrame, after: Compared
    ) -> FrameLabels:
        lost = OdometryState.LOST in (this.odometry, other.odometry)
        if lost:
            health = FrameHealth(Blindness.NO_POSE, "odometry lost")
        elif not 0 < other.frame.stamp_ns - this.frame.stamp_ns <= MAX_GAP_NS:
            health = FrameHealth(Blindness.NO_PAST, "the next frame is too far away in time")
        elif not len(seen.kept) or not len(after.kept):
            health = FrameHealth(Blindness.NO_POINTS, "the camera sees nothing near off the ground")
        else:
            return _labels(this.frame, seen, self.chain(this, seen, other, after), FrameHealth())
        return _labels(this.frame, seen, None, health)


def _labels(
    frame: LidarFrame, seen: Compared, chain: Chain | None, health: FrameHealth
) -> FrameLabels:
    labels = np.full(len(frame), MotionLabel.UNKNOWN, np.uint8)
    confidence = np.zeros(len(frame), np.float16)
    if chain is not None:
        judged = seen.kept[chain.near]
        labels[judged] = np.where(chain.found.dynamic, MotionLabel.DYNAMIC, MotionLabel.STATIC)
        confidence[judged] = ALONE
    return FrameLabels(
        labels=labels,
        confidence=confidence,
        ground_mask=seen.ground == GROUND,
        health=health,
    )
