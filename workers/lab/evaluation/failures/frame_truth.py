"""Labelled frames with ground truth: both streams' labels next to the true motion."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask
from schemas.contradiction import LabelledFrame
from schemas.labels import FrameLabels, MotionLabel
from workers.lab.evaluation.truth.truth import TRUTH_DYNAMIC, TRUTH_UNKNOWN, FrameTruth


@runtime_checkable
class UncertaintyBuffer(Protocol):
    """A stream that buffers per-point uncertainty for recent frames."""

    def take(self, stamp_ns: int) -> Mapping[str, NDArray[np.float32]]:
        """Remove and return the uncertainty buffered for the frame of this stamp."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class FrameWithTruth:
    """A labelled frame of a scene with its truth.

    Attributes:
        labelled: Frame with the labels of both streams.
        truth: Truth of its points; None where the log has none for this frame.
        unsure: Uncertainty of the networks per point, (N,) by name of the measure.
    """

    labelled: LabelledFrame
    truth: FrameTruth | None
    unsure: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)

    @property
    def motion(self) -> NDArray[np.uint8]:
        """(N,) true motion, in codes of the truth."""
        if self.truth is None:
            return np.full(len(self.labelled.agreements), TRUTH_UNKNOWN, np.uint8)
        return self.truth.motion

    @property
    def known(self) -> Mask:
        """(N,) points whose true motion is known."""
        known: Mask = self.motion != TRUTH_UNKNOWN
        return known

    @property
    def moving(self) -> Mask:
        """(N,) points that truly move."""
        moving: Mask = self.motion == TRUTH_DYNAMIC
        return moving

    @property
    def track(self) -> NDArray[np.int64]:
        """(N,) true object of each point, -1 none."""
        if self.truth is None or self.truth.track is None:
            return np.full(len(self.labelled.agreements), -1, np.int64)
        return self.truth.track.astype(np.int64)

    def wrong(self, predicted: FrameLabels) -> Mask:
        """(N,) points that a stream labels opposite to the truth; UNKNOWN is not wrong."""
        compared = self.known & (predicted.labels != MotionLabel.UNKNOWN)
        wrong: Mask = compared & ((predicted.labels == MotionLabel.DYNAMIC) != self.moving)
        return wrong

    def class_of(self, track: int) -> str:
        """Return the true class of an object; empty where truth has none."""
        known = self.truth.objects.get(track) if self.truth is not None else None
        return "" if known is None else known.class_name
