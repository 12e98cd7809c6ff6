"""A user's own model as the supervised stream: exported networks, described by their adapter."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.checkpoints.errors import WeightsUnusableError
from workers.lidar.range_image import SensorProfile
from workers.supervised.adapter import Adapter, NetworkEntry
from workers.supervised.classes import ClassMeaning
from workers.supervised.point_stream import PointStream
from workers.supervised.residual_image import ResidualSettings
from workers.supervised.runtimes import open_network
from workers.supervised.stream import RangeImageStream


class OwnNetwork:
    """An exported network with the classes of its outputs.

    Args:
        entry: Its entry in the adapter.
        folder: Folder of the adapter.
        profile: Layout of the range image; None for a network over points.

    Raises:
        WeightsUnusableError: If it cannot be opened, or its output has another shape than stated.
    """

    def __init__(self, entry: NetworkEntry, folder: Path, profile: SensorProfile | None) -> None:
        self._entry, self._profile = entry, profile
        self._path = folder / entry.file
        self._run, stored = open_network(self._path, output=entry.output)
        stored.update(entry.model_dump_json().encode())
        stored.update(repr(profile).encode())
        self.digest = stored.hexdigest()
        count = len(entry.channels) + (len(entry.residual.ages_s) if entry.residual else 0)
        trial = (17, count) if profile is None else (count, profile.rows, profile.columns)
        self.probabilities(np.zeros(trial, dtype=np.float32))

    @property
    def profile(self) -> SensorProfile:
        """Layout and normalisation of the range image."""
        if self._profile is None:
            raise WeightsUnusableError(f"a network over points has no range image ({self._path})")
        return self._profile

    @property
    def channels(self) -> tuple[str, ...]:
        """Input channels, in order."""
        return self._entry.channels

    @property
    def residual(self) -> ResidualSettings | None:
        """Past frames of its residual images."""
        return self._entry.residual

    @property
    def classes(self) -> tuple[ClassMeaning, ...]:
        """Meaning of each output."""
        return self._entry.classes

    def probabilities(self, array: NDArray[np.float32]) -> NDArray[np.float32]:
        """Run the network.

        Args:
            array: (C, H, W) image, or (N, C) points.

        Returns:
            (K, H, W), or (K, N): probabilities of the classes; 0 or 1 where its output is class
            numbers.

        Raises:
            WeightsUnusableError: If it fails, or its output differs from its adapter.
        """
        answer = self._run(array[None])
        self._check_kind(answer)
        classes, places = len(self._entry.classes), array.shape[1:]
        is_image = self._profile is not None
        if not is_image:
            places = array.shape[:1]
        if self._entry.answer == "labels":
            expected: tuple[int, ...] = (1, *places)
        else:
            expected = (1, classes, *places) if is_image else (1, *places, classes)
        if answer.shape != expected:
            raise WeightsUnusableError(
                f"the network gives {answer.shape}; {self._entry.answer} of {classes} classes are "
                f"{expected}: see answer and classes of the adapter ({self._path})"
            )
        if self._entry.answer == "labels":
            return self._certain(answer[0])
        with np.errstate(over="ignore"):  # it becomes infinite, which is refused
            scores = answer[0].astype(np.float32)
        if not np.isfinite(scores).all():
            raise WeightsUnusableError(f"the network gives NaN or infinite scores ({self._path})")
        scores = scores if is_image else np.ascontiguousarray(scores.T)
        if self._entry.answer == "probabilities" and not _are_shares(scores):
            raise WeightsUnusableError(
                "the network gives numbers that are no probabilities: they leave 0 to 1, or do not "
                'add up to 1; if they are scores, the adapter says answer = "logits" '
                f"({self._path})"
            )
        return _softmax(scores) if self._entry.answer == "logits" else scores

    def _check_kind(self, answer: object) -> None:
        """Check that the output is an array of the number type in its adapter; nothing is cast."""
        wanted, name = (
            (np.integer, "integers") if self._entry.answer == "labels" else (np.floating, "floats")
        )
        if not isinstance(answer, np.ndarray):
            given = type(answer).__name__
        elif not np.issubdtype(answer.dtype, wanted):
            given = str(answer.dtype)
        else:
            return
        raise WeightsUnusableError(
            f"the network gives {given}; {self._entry.answer} are an array of {name}: see answer "
            f"of the adapter, or export the network with another output ({self._path})"
        )

    def _certain(self, numbers: NDArray[Any]) -> NDArray[np.float32]:
        classes = len(self._entry.classes)
        odd = numbers[(numbers < 0) | (numbers >= classes)]
        if odd.size:
            raise WeightsUnusableError(
                f"the network gives class {odd[0]}, its adapter names {classes}, counted from 0 "
                f"({self._path})"
            )
        return np.stack([(numbers == number).astype(np.float32) for number in range(classes)])


def _are_shares(scores: NDArray[np.float32]) -> bool:
    low, high = (scores.min(), scores.max()) if scores.size else (0.0, 1.0)
    sums = scores.sum(axis=0)
    return bool(low > -0.01 and high < 1.01 and (np.abs(sums - 1) < 0.05).all())


def _softmax(scores: NDArray[np.float32]) -> NDArray[np.float32]:
    raised = np.exp(scores - scores.max(axis=0, keepdims=True))
    shares: NDArray[np.float32] = raised / raised.sum(axis=0, keepdims=True)
    return shares


def open_own_model(path: Path) -> RangeImageStream | PointStream:
    """Open the model that an adapter describes.

    Raises:
        WeightsUnusableError: If the adapter is contradictory, or a network differs from it.
    """
    adapter = Adapter.read(path)
    semantic, motion = (
        None if entry is None else OwnNetwork(entry, path.parent, adapter.image)
        for entry in (adapter.semantic, adapter.motion)
    )
    if adapter.image is None:
        return PointStream(semantic, motion, name=adapter.name)
    return RangeImageStream(semantic, motion, name=adapter.name)
