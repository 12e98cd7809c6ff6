"""Weights of the supervised stream: their card, and how they are stored and loaded."""

from pathlib import Path
from typing import Final, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from workers.checkpoints import stored_weights
from workers.checkpoints.devices import Device
from workers.checkpoints.errors import WeightsUnusableError
from workers.checkpoints.stored_weights import Card
from workers.lidar.range_image import CHANNELS, Channel, SensorProfile
from workers.supervised.adapter import MAX_CHANNELS
from workers.supervised.classes import ClassMeaning
from workers.supervised.folded import FoldedSalsaNext
from workers.supervised.lmnet import MOVING, LMNet
from workers.supervised.networks import FRAMES_TOGETHER, run_network
from workers.supervised.residual_image import ResidualSettings
from workers.supervised.salsanext import SalsaNext

MAX_WIDTH: Final = 128
"""Largest width: four times the published networks, sixteen times their parameters, 430 MB."""


class WeightsCard(Card):
    """Card of SalsaNext or LMNet: all settings that change the output, and credits."""

    network: Literal["salsanext", "lmnet"]
    classes: tuple[ClassMeaning, ...] = Field(
        min_length=2, max_length=254, description="In the order of outputs."
    )
    width: int = Field(
        ge=4, le=MAX_WIDTH, multiple_of=4, description="Channels of the first stage."
    )
    profile: SensorProfile = Field(description="Layout and normalisation of the range image.")
    channels: tuple[Channel, ...] = Field(
        default=CHANNELS,
        min_length=1,
        max_length=MAX_CHANNELS,
        description="Which measurements the network sees, in this order.",
    )
    residual: ResidualSettings | None = Field(default=None, description="LMNet's past frames.")
    teacher: Literal["", "selfsupervised"] = Field(
        default="",
        exclude_if=lambda value: not value,
        description="Stream whose labels the network was taught; empty: truth.",
    )

    def build(self) -> SalsaNext:
        """Build the network of these weights, with random parameters.

        Raises:
            WeightsUnusableError: If classes or residuals do not fit the network.
        """
        if (self.network == "lmnet") != (self.residual is not None):
            raise WeightsUnusableError(
                f"weights of {self.network} must name residuals if and only if it is lmnet"
            )
        if self.residual is None:
            return SalsaNext(
                in_channels=len(self.channels), classes=len(self.classes), width=self.width
            )
        net = LMNet(
            measured=len(self.channels), residuals=len(self.residual.ages_s), width=self.width
        )
        if len(self.classes) != net.logits.out_channels:
            raise WeightsUnusableError(
                f"lmnet has {net.logits.out_channels} classes, its weights name {len(self.classes)}"
            )
        return net


class LoadedWeights:
    """A loaded network with its card.

    Attributes:
        net: The network in evaluation mode, float32.
        card: The sidecar.
        digest: Hex sha256 of both files' bytes.
    """

    def __init__(
        self,
        net: SalsaNext,
        card: WeightsCard,
        digest: str,
        *,
        folded: bool = False,
        device: Device = "cpu",
    ) -> None:
        self.net, self.card = net, card
        self.digest = f"{digest} folded" if folded else digest
        if device == "cuda":  # its sums have another order, which follows the size of a batch too
            self.digest = f"{self.digest} cuda x{FRAMES_TOGETHER[device]}"
            net.to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]  # missing in the stub
        self._device = device
        self._run = FoldedSalsaNext(net) if folded else net

    @property
    def profile(self) -> SensorProfile:
        """Layout and normalisation of the image."""
        return self.card.profile

    @property
    def channels(self) -> tuple[str, ...]:
        """Input channels, in order."""
        return self.card.channels

    @property
    def residual(self) -> ResidualSettings | None:
        """Past frames of LMNet's residual images."""
        return self.card.residual

    @property
    def classes(self) -> tuple[ClassMeaning, ...]:
        """Meaning of each output. The first, "unlabelled", is not trained; LMNet labels motion."""
        tells_motion = self.card.network == "lmnet"
        return tuple(
            meaning.model_copy(
                update={"ignored": number == 0, "moving": tells_motion and number == MOVING}
            )
            for number, meaning in enumerate(self.card.classes)
        )

    def probabilities(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Map an image (C, H, W) to the probabilities of its classes (K, H, W)."""
        answer: NDArray[np.float32] = run_network(self._run, image[None], self._device)[0]
        return answer

    def probabilities_together(self, images: NDArray[np.float32]) -> NDArray[np.float32]:
        """Map images (B, C, H, W) to the probabilities of their classes (B, K, H, W)."""
        return run_network(self._run, images, self._device)


def save_weights(path: Path, net: SalsaNext, card: WeightsCard) -> None:
    """Write weights as safetensors, with their sidecar in the same folder.

    Convolution kernels are stored in half precision, everything else unchanged. This halves the
    size, and changes the outputs by less than one rounding of the confidences.

    Args:
        path: The `.safetensors` file; the sidecar has the suffix `.json`.
        net: The trained network.
        card: Card of the weights.
    """
    tensors = {
        key: value.half() if value.ndim == 4 else value for key, value in net.state_dict().items()
    }
    stored_weights.save(path, tensors, card)


def load_weights(path: Path, *, folded: bool = False, device: Device = "cpu") -> LoadedWeights:
    """Load weights after checking that every parameter is there and fits; no partial load.

    Args:
        path: The `.safetensors` file; its sidecar is in the same folder.
        folded: Run it folded, faster on a CPU; the outputs differ by rounding, the digest too. A
            torch without oneDNN runs it layer by layer, with the digest of that form, and so does a
            GPU.
        device: Device to run it on; a GPU is part of the digest.

    Returns:
        The network in evaluation mode.

    Raises:
        WeightsUnusableError: If a file is missing or damaged, or keys or shapes differ; the message
            names the file and what differs.
    """
    read = stored_weights.load(path, WeightsCard, WeightsCard.build)
    folds = folded and device == "cpu" and bool(torch.backends.mkldnn.is_available())  # type: ignore[no-untyped-call]
    return LoadedWeights(read.net, read.card, read.digest, folded=folds, device=device)
