"""Supervised stream of networks over points, without a range image."""

import hashlib
from collections.abc import Iterable, Iterator
from typing import Final, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import FrameLabels
from schemas.task import Task
from workers.supervised.classes import ClassMeaning, ClassSet
from workers.supervised.fusion import MotionFusion

_REVISION: Final = "1"
"""Revision of the code; increases when the same networks give other labels."""


class PointNetwork(Protocol):
    """A network over points."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Input channels among range, x, y, z (metres, sensor space) and intensity, in order."""
        ...

    @property
    def classes(self) -> tuple[ClassMeaning, ...]:
        """Meaning of each output."""
        ...

    @property
    def digest(self) -> str:
        """Hex digest of everything that changes its output."""
        ...

    def probabilities(self, array: NDArray[np.float32]) -> NDArray[np.float32]:
        """Map points (N, C) to the probabilities of their classes (K, N)."""
        ...


class PointStream:
    """Networks over the valid points of each frame; the others are UNKNOWN.

    Args:
        semantic: Network of semantic classes; None if only motion is known.
        motion: Network of motion; None if the semantic classes include motion.
        name: Name of the stream in versions.
    """

    def __init__(
        self, semantic: PointNetwork | None, motion: PointNetwork | None, *, name: str
    ) -> None:
        self._networks = [network for network in (semantic, motion) if network is not None]
        self._classes = [ClassSet(network.classes) for network in self._networks]
        self._name = name
        self._fusion = MotionFusion(
            kinds=None if semantic is None else self._classes[0],
            motions=None if motion is None else self._classes[-1],
        )

    @property
    def task(self) -> Task:
        """Task of its labels."""
        return self._fusion.task

    @property
    def version(self) -> str:
        """`name@digest` of code revision and networks."""
        parts = " ".join((_REVISION, *(network.digest for network in self._networks)))
        return f"{self._name}@{hashlib.sha256(parts.encode()).hexdigest()[:12]}"

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names that `FrameLabels.class_id` indexes; none where only motion is known."""
        kinds = self._fusion.kinds
        return () if kinds is None else tuple(meaning.name for meaning in kinds.classes)

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame, in order."""
        torch.set_num_threads(1)  # a worker owns one core, and sums keep their order
        for posed in frames:
            yield self._label(posed.frame)

    def _label(self, frame: LidarFrame) -> FrameLabels:
        valid = np.flatnonzero(frame.valid_mask)
        measured = _measured(frame, valid)
        answers, points = [], []
        for network, classes in zip(self._networks, self._classes, strict=True):
            columns = [measured[channel] for channel in network.channels]
            answer = network.probabilities(np.stack(columns, axis=1)) if len(valid) else None
            whole = np.zeros((len(network.classes), len(frame)), dtype=np.float32)
            codes = np.zeros(len(frame), dtype=np.uint8)
            if answer is not None:
                whole[:, valid], codes[valid] = answer, classes.best(answer)
            answers.append(whole)
            points.append(classes.class_of(codes))
        fusion = self._fusion
        semantic = answers[0] if fusion.kinds is not None else None
        motion = answers[-1] if fusion.motions is not None else None
        return fusion.labels(
            judged_mask=frame.valid_mask,
            kind=points[0] if semantic is not None else None,
            motion=points[-1] if motion is not None else None,
            second_share=fusion.second_share(semantic, motion),
        )


def _measured(frame: LidarFrame, valid: NDArray[np.intp]) -> dict[str, NDArray[np.float32]]:
    points_m = frame.points_m[valid]
    x, y, z = points_m.T
    range_m = np.sqrt(x * x + y * y + z * z)
    return {"range": range_m, "x": x, "y": y, "z": z, "intensity": frame.intensity[valid]}
