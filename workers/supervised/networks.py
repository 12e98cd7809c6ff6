"""Protocol of range image networks of the supervised stream, for any training and any runtime."""

from collections.abc import Callable
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from workers.lidar.range_image import SensorProfile
from workers.supervised.classes import ClassMeaning
from workers.supervised.residual_image import ResidualSettings


class RangeImageNetwork(Protocol):
    """A network over range images.

    Attributes:
        profile: Layout and normalisation of the image.
        channels: Its input channels among `workers.lidar.range_image.CHANNELS`, in order.
        residual: The past frames whose residuals follow these channels; None for none.
        classes: Meaning of each output.
        digest: Hex digest of everything that changes its output.
    """

    @property
    def profile(self) -> SensorProfile:
        """Layout and normalisation of the image."""
        ...

    @property
    def channels(self) -> tuple[str, ...]:
        """Input channels, in order."""
        ...

    @property
    def residual(self) -> ResidualSettings | None:
        """Past frames of its residual images."""
        ...

    @property
    def classes(self) -> tuple[ClassMeaning, ...]:
        """Meaning of each output."""
        ...

    @property
    def digest(self) -> str:
        """Hex digest of everything that changes its output."""
        ...

    def probabilities(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Map an image (C, H, W) to the probabilities of its classes (K, H, W)."""
        ...


def run_eagerly(
    net: Callable[[torch.Tensor], torch.Tensor], image: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Run a torch network over one image: (C, H, W) in, (K, H, W) out."""
    x = torch.from_numpy(image)[None].contiguous(memory_format=torch.channels_last)
    with torch.inference_mode():
        answer: NDArray[np.float32] = net(x)[0].contiguous().numpy()
    return answer
