"""The task `ground` without labels: the ground points of Patchwork++ in each frame."""

from collections.abc import Iterable, Iterator
from typing import ClassVar, Final

import numpy as np

from schemas.frame import PosedFrame
from schemas.labels import FrameHealth, FrameLabels
from schemas.task import GROUND, Task
from workers.lidar.beam_table import MIN_RANGE_M
from workers.lidar.preprocessing import MAX_RANGE_M, PreprocessedFrame, Preprocessor
from workers.part_version import version_of
from workers.points.point_kernels import within
from workers.selfsupervised.labelling import GROUND as GROUND_SURE

_OTHER: Final = GROUND.classes.index("other")
_GROUND: Final = GROUND.classes.index("ground")


class GroundStream:
    """Labels the ground points of each frame that the default motion stream removes.

    Patchwork++ has no probability, so all labels have one confidence. Points nearer than the roof
    of the car, or farther than 80 m, are unknown. `FrameLabels.ground_mask` stays None: this task
    is about the ground, so none of it may be left out as background.
    """

    task: ClassVar[Task] = GROUND
    class_names: tuple[str, ...] = ()

    @property
    def version(self) -> str:
        """`ground@digest` of code and libraries."""
        return version_of("ground")

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame, in order."""
        prepare = Preprocessor()
        for posed in frames:
            prepared = prepare(posed.frame, posed.odom_from_sensor, None)
            health = prepare.problem(posed.frame) if prepared is None else FrameHealth()
            yield _labels(len(posed.frame), prepared, health)


def _labels(points: int, prepared: PreprocessedFrame | None, health: FrameHealth) -> FrameLabels:
    labels = np.full(points, GROUND.unknown, np.uint8)
    confidence = np.zeros(points, np.float16)
    if prepared is not None:
        near = within(prepared.points_m, MIN_RANGE_M, MAX_RANGE_M)
        at = prepared.valid_index[near]
        labels[at] = np.where(prepared.ground[near], np.uint8(_GROUND), np.uint8(_OTHER))
        confidence[at] = GROUND_SURE
    return FrameLabels(labels=labels, confidence=confidence, health=health)
