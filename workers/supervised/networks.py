"""Protocol of range image networks of the supervised stream, for any training and any runtime."""

from collections.abc import Callable, Sequence
from typing import Final, Protocol, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray

from workers.checkpoints.devices import Device
from workers.lidar.range_image import SensorProfile
from workers.supervised.classes import ClassMeaning
from workers.supervised.residual_image import ResidualSettings

FRAMES_TOGETHER: Final[dict[Device, int]] = {"cpu": 1, "cuda": 8}
"""Frames that the networks run over at once.

A GPU is idle between kernels of one image. On the processor the label of a frame would only wait
for later ones. Eight images of 64 x 2048 are 0.2 GB in the widest layer of the published networks.
"""


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


@runtime_checkable
class BatchedNetwork(RangeImageNetwork, Protocol):
    """A network over range images that answers several of them at once."""

    def probabilities_together(self, images: NDArray[np.float32]) -> NDArray[np.float32]:
        """Map images (B, C, H, W) to the probabilities of their classes (B, K, H, W)."""
        ...


def answers_of(
    network: RangeImageNetwork, images: Sequence[NDArray[np.float32]]
) -> list[NDArray[np.float32]]:
    """Run a network over images of one layout: at once where it can, else one after the other.

    Args:
        network: The network.
        images: (C, H, W) each; at least one.

    Returns:
        (K, H, W) for each image.
    """
    if len(images) > 1 and isinstance(network, BatchedNetwork):
        return list(network.probabilities_together(np.stack(images)))
    return [network.probabilities(image) for image in images]


def run_network(
    net: Callable[[torch.Tensor], torch.Tensor], images: NDArray[np.float32], device: Device
) -> NDArray[np.float32]:
    """Run a torch network on its device over images: (B, C, H, W) in, (B, K, H, W) out."""
    x = torch.from_numpy(images).to(device).contiguous(memory_format=torch.channels_last)
    with torch.inference_mode():
        answers: NDArray[np.float32] = net(x).contiguous().cpu().numpy()
    return answers
