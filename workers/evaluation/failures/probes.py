"""How unsure the networks are of every point: entropy, margin, MC-dropout, a second network.

What a user without a second stream would rank by; none of it changes a label.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import tee
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import torch
from numpy.typing import NDArray

from schemas.frame import PosedFrame
from schemas.labels import FrameLabels, MotionLabel
from schemas.work import MiningSettings
from workers.geometry.form import Form
from workers.geometry.range_image import RangeImage
from workers.supervised.networks import RangeImageNetwork
from workers.supervised.residual_image import Past
from workers.supervised.stream import SHIPPED, RangeImageStream
from workers.supervised.uncertainty import mc_dropout
from workers.supervised.weights import LoadedWeights

PASSES: Final = 8
NETWORKS: Final = ("salsanext-lmnet", "salsanext-lmnet:folded")
"""Streams that can be probed."""

Views = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True, slots=True)
class Probing:
    """What is asked of the networks beside their labels.

    Attributes:
        dropout_every: MC-dropout on one frame in so many; 0: none.
        second: Folder of the weights of a second pair of networks; empty: none.
    """

    dropout_every: int = 0
    second: str = ""


NO_PROBING: Final = Probing()


class ProbedStream:
    """A stream of two networks that keeps, for a while, how unsure it was of each point.

    Labels, and the version, are those of the stream itself.
    """

    def __init__(self, inner: "_Probed", second: RangeImageStream | None) -> None:
        self._inner, self._second = inner, second
        self._differs: dict[int, NDArray[np.float32]] = {}

    @classmethod
    def of(cls, settings: MiningSettings, probing: Probing) -> Self | None:
        """Probe the stream that the settings name; None where it is none of two networks."""
        if settings.supervised not in NETWORKS:
            return None
        folder = Path(settings.weights) if settings.weights else SHIPPED
        inner = _Probed.salsanext_lmnet(folder)
        inner.dropout_every = probing.dropout_every
        other = RangeImageStream.salsanext_lmnet(Path(probing.second)) if probing.second else None
        return cls(inner, other)

    @property
    def version(self) -> str:
        """That of the stream that is probed."""
        return self._inner.version

    @property
    def class_names(self) -> tuple[str, ...]:
        """Those of the stream that is probed."""
        return self._inner.class_names

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame, in order."""
        self._inner.views.clear()
        self._differs.clear()
        stamped, mine, others = tee(frames, 3)
        second = self._second(others) if self._second is not None else None
        for posed, said in zip(stamped, self._inner(mine), strict=True):
            if second is not None:
                apart = np.abs(_dynamic(said) - _dynamic(next(second)))
                self._differs[posed.frame.stamp_ns] = apart
            yield said

    def take(self, stamp_ns: int) -> Views:
        """Hand over what was kept of a frame, and forget it and all earlier ones."""
        views = dict(self._inner.views.get(stamp_ns, {}))
        if stamp_ns in self._differs:
            views["ensemble"] = self._differs[stamp_ns]
        _forget(self._inner.views, stamp_ns)
        _forget(self._differs, stamp_ns)
        return views


class _Probed(RangeImageStream):
    """The stream itself, which notes what its networks say pixel by pixel."""

    dropout_every = 0

    def __init__(self, *networks: RangeImageNetwork | None, name: str, form: Form) -> None:
        super().__init__(*networks, name=name, form=form)
        self.views: dict[int, Views] = {}
        self._frame = 0
        self._dropout: list[NDArray[np.float32]] = []
        self._unsure: Views = {}

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        self.views.clear()
        self._frame = 0
        yield from super().__call__(frames)

    def _label(self, posed: PosedFrame, pasts: Sequence[Past | None]) -> FrameLabels:
        self._dropout = []
        asked = self.dropout_every > 0 and self._frame % self.dropout_every == 0
        networks = self._networks
        self._unsure = {}
        if asked:
            self._networks = [_Dropped(each, self._dropout, self._frame) for each in networks]
        try:
            said = super()._label(posed, pasts)
        finally:
            self._networks = networks
        self._frame += 1
        self.views[posed.frame.stamp_ns] = self._unsure
        return said

    def _fused(
        self, image: RangeImage, answers: Sequence[NDArray[np.float32]], *, has_past: bool
    ) -> FrameLabels:
        entropy = np.mean([_entropy(each) for each in answers], axis=0)
        margin = np.max([_narrowness(each) for each in answers], axis=0)
        unsure = {"entropy": _at(image, entropy), "margin": _at(image, margin)}
        if self._dropout:
            unsure["mc_dropout"] = _at(image, np.max(self._dropout, axis=0))
        self._unsure = unsure
        return super()._fused(image, answers, has_past=has_past)


class _Dropped:
    """A network that is asked eight times more, without a random share of its channels."""

    def __init__(
        self, inner: RangeImageNetwork, kept: list[NDArray[np.float32]], seed: int
    ) -> None:
        self._inner, self._kept, self._seed = inner, kept, seed
        self.profile, self.channels = inner.profile, inner.channels
        self.residual, self.classes = inner.residual, inner.classes
        self.digest = inner.digest

    def probabilities(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Answer as the network does, and note how much the other answers spread."""
        if isinstance(self._inner, LoadedWeights):
            spread = mc_dropout(
                self._inner.net, torch.from_numpy(image)[None], passes=PASSES, seed=self._seed
            )
            self._kept.append(spread.uncertainty[0].numpy())
        return self._inner.probabilities(image)


def _forget(kept: dict[int, Any], until_ns: int) -> None:
    for stamp in [each for each in kept if each <= until_ns]:
        del kept[stamp]


def _dynamic(said: FrameLabels) -> NDArray[np.float32]:
    """How likely each point is dynamic, from label and confidence; a half where it is unknown."""
    sure = said.confidence.astype(np.float32)
    likely = np.where(said.labels == MotionLabel.DYNAMIC, sure, 1.0 - sure)
    return np.where(said.labels == MotionLabel.UNKNOWN, 0.5, likely).astype(np.float32)


def _entropy(answer: NDArray[np.float32]) -> NDArray[np.float32]:
    """Entropy of (K, H, W) probabilities over that of knowing nothing, 0 to 1."""
    safe = np.clip(answer, 1e-7, 1.0)
    entropy: NDArray[np.float32] = -(safe * np.log(safe)).sum(axis=0) / np.log(len(answer))
    return entropy


def _narrowness(answer: NDArray[np.float32]) -> NDArray[np.float32]:
    """One minus the lead of the best class over the second, (H, W)."""
    best = np.partition(answer, -2, axis=0)[-2:]
    narrow: NDArray[np.float32] = 1.0 - (best[1] - best[0])
    return narrow


def _at(image: RangeImage, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Value of the pixel of each point; NaN where it is in none."""
    inside = image.row >= 0
    of_points = np.full(len(image.row), np.nan, np.float32)
    of_points[inside] = values[image.row[inside], image.column[inside]]
    return of_points
