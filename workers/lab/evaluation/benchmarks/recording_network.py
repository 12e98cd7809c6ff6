"""A network that keeps its input images, so that they can be run again and timed."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from workers.lidar.range_image import SensorProfile
from workers.supervised.classes import ClassMeaning
from workers.supervised.residual_image import ResidualSettings
from workers.supervised.weights import LoadedWeights


@dataclass(slots=True)
class RecordingNetwork:
    """A `RangeImageNetwork` that keeps its input images.

    Attributes:
        weights: The network.
        images: (C, H, W) each, in order.
    """

    weights: LoadedWeights
    images: list[NDArray[np.float32]] = field(default_factory=list)

    @property
    def profile(self) -> SensorProfile:
        """Layout and normalisation of the image."""
        return self.weights.profile

    @property
    def channels(self) -> tuple[str, ...]:
        """Input channels, in order."""
        return self.weights.channels

    @property
    def residual(self) -> ResidualSettings | None:
        """Past frames of its residual images."""
        return self.weights.residual

    @property
    def classes(self) -> tuple[ClassMeaning, ...]:
        """Meaning of each output."""
        return self.weights.classes

    @property
    def digest(self) -> str:
        """Hex digest of everything that changes its output."""
        return self.weights.digest

    def probabilities(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Keep an image (C, H, W) and map it to the probabilities of its classes (K, H, W)."""
        self.images.append(image)
        return self.weights.probabilities(image)
