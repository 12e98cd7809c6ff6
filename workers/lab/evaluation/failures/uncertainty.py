"""Per-point network uncertainty: entropy, margin, MC-dropout and ensemble.

These are the baselines of a user without a second stream; none of them changes a label.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import tee
from pathlib import Path
from types import MappingProxyType
from typing import Final, Self

import numpy as np
import torch
from numpy.typing import NDArray

from schemas.frame import PosedFrame
from schemas.labels import FrameLabels, MotionLabel
from schemas.mining import MiningSettings
from schemas.task import Task
from workers.lidar.range_image import RangeImage
from workers.supervised.networks import RangeImageNetwork
from workers.supervised.stream import SHIPPED, RangeImageStream
from workers.supervised.uncertainty import mc_dropout
from workers.supervised.weights import LoadedWeights

PASSES: Final = 8
PROBED: Final = "salsanext-lmnet"
"""Name of the only stream that can be probed."""

Measures = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True, slots=True)
class Probing:
    """Uncertainty measures to compute in addition to the labels.

    Attributes:
        dropout_every: MC-dropout on one frame in this many; 0: none.
        second: Folder of the weights of a second pair of networks; empty: none.
    """

    dropout_every: int = 0
    second: str = ""


NO_PROBING: Final = Probing()


class ProbedStream:
    """A stream of two networks that buffers its uncertainty of each point for recent frames.

    Labels and version are those of the stream itself.
    """

    def __init__(self, inner: "_RecordingStream", second: RangeImageStream | None) -> None:
        self._inner, self._second = inner, second
        self._buffer: dict[int, Measures] = {}

    @classmethod
    def of(cls, settings: MiningSettings, probing: Probing) -> Self | None:
        """Probe the stream that the settings name; None where it has no two networks."""
        if settings.supervised != PROBED:
            return None
        folder = Path(settings.weights) if settings.weights else SHIPPED
        inner = _RecordingStream.salsanext_lmnet(folder)
        inner.enable_dropout(every=probing.dropout_every)
        other = RangeImageStream.salsanext_lmnet(Path(probing.second)) if probing.second else None
        return cls(inner, other)

    @property
    def version(self) -> str:
        """Version of the probed stream."""
        return self._inner.version

    @property
    def task(self) -> Task:
        """Task of the probed stream."""
        return self._inner.task

    @property
    def class_names(self) -> tuple[str, ...]:
        """Class names of the probed stream."""
        return self._inner.class_names

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame, in order."""
        self._buffer.clear()
        self._inner.begin()
        stamped, mine, others = tee(frames, 3)
        second = self._second(others) if self._second is not None else None
        for posed, labels in zip(stamped, self._inner(mine), strict=True):
            unsure = dict(self._inner.measures)
            if second is not None:
                unsure["ensemble"] = np.abs(_dynamic(labels) - _dynamic(next(second)))
            self._buffer[posed.frame.stamp_ns] = unsure
            yield labels

    def take(self, stamp_ns: int) -> Measures:
        """Return the uncertainty of a frame, and discard it with all earlier ones."""
        views = self._buffer.get(stamp_ns, {})
        for stamp in [each for each in self._buffer if each <= stamp_ns]:
            del self._buffer[stamp]
        return views


class _RecordingStream(RangeImageStream):
    """The stream itself; it also records per-pixel uncertainty of the networks for each frame."""

    measures: Measures = MappingProxyType({})
    _probes: Sequence["_DropoutProbe"] = ()

    def enable_dropout(self, *, every: int) -> None:
        """Apply MC-dropout on one frame in this many; 0: never."""
        if every:
            self._probes = [_DropoutProbe(each, every) for each in self._networks]
            self._networks = list(self._probes)

    def begin(self) -> None:
        """Reset the frame counters at the start of a log."""
        for network in self._probes:
            network.frame = 0

    def _fused(
        self, image: RangeImage, answers: Sequence[NDArray[np.float32]], *, has_past: bool
    ) -> FrameLabels:
        entropy = np.mean([_entropy(each) for each in answers], axis=0)
        margin = np.max([_narrowness(each) for each in answers], axis=0)
        measures = {"entropy": _at(image, entropy), "margin": _at(image, margin)}
        spreads = [each.spread for each in self._probes if each.spread is not None]
        if spreads:
            measures["mc_dropout"] = _at(image, np.max(spreads, axis=0))
        self.measures = measures
        return super()._fused(image, answers, has_past=has_past)


class _DropoutProbe:
    """A network with eight extra MC-dropout passes on every n-th frame.

    Attributes:
        frame: Number of frames so far.
        spread: (H, W) spread of these passes on the last frame; None if there were none.
    """

    def __init__(self, inner: RangeImageNetwork, every: int) -> None:
        self._inner, self._every = inner, every
        self.profile, self.channels = inner.profile, inner.channels
        self.residual, self.classes = inner.residual, inner.classes
        self.digest = inner.digest
        self.frame = 0
        self.spread: NDArray[np.float32] | None = None

    def probabilities(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the network's probabilities, and record the spread of the dropout passes."""
        self.spread = None
        if isinstance(self._inner, LoadedWeights) and self.frame % self._every == 0:
            asked = torch.from_numpy(image)[None]
            sampled = mc_dropout(self._inner.net, asked, passes=PASSES, seed=self.frame)
            self.spread = sampled.uncertainty[0].numpy()
        self.frame += 1
        return self._inner.probabilities(image)


def _dynamic(labels: FrameLabels) -> NDArray[np.float32]:
    """Return the probability of dynamic of each point from label and confidence; unknown is 0.5."""
    sure = labels.confidence.astype(np.float32)
    likely = np.where(labels.labels == MotionLabel.DYNAMIC, sure, 1.0 - sure)
    return np.where(labels.labels == MotionLabel.UNKNOWN, 0.5, likely).astype(np.float32)


def _entropy(answer: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the entropy of (K, H, W) probabilities over that of a uniform answer, 0 to 1."""
    safe = np.clip(answer, 1e-7, 1.0)
    entropy: NDArray[np.float32] = -(safe * np.log(safe)).sum(axis=0) / np.log(len(answer))
    return entropy


def _narrowness(answer: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return one minus the margin of the best class over the second, (H, W)."""
    best = np.partition(answer, -2, axis=0)[-2:]
    narrow: NDArray[np.float32] = 1.0 - (best[1] - best[0])
    return narrow


def _at(image: RangeImage, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the pixel value of each point; NaN outside the image."""
    inside = image.row >= 0
    of_points = np.full(len(image.row), np.nan, np.float32)
    of_points[inside] = values[image.row[inside], image.column[inside]]
    return of_points
