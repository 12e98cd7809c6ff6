"""Weights on disk: a safetensors file and a JSON sidecar that says what they belong to."""

import hashlib
import json
from pathlib import Path
from typing import Literal

import numpy as np
import safetensors
import safetensors.torch
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from schemas.errors import PermanentError
from workers.geometry.range_image import CHANNELS, SensorProfile
from workers.supervised.classes import ClassMeaning
from workers.supervised.lmnet import MOVING, LMNet
from workers.supervised.networks import run_eagerly
from workers.supervised.residual_image import ResidualSettings
from workers.supervised.salsanext import SalsaNext


class WeightsUnusableError(PermanentError):
    """Weights are missing, damaged, or belong to another network than their sidecar says."""


class WeightsCard(BaseModel):
    """Everything beside the numbers that changes what a network says, and whom to thank."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    format_version: Literal[1] = 1
    network: Literal["salsanext", "lmnet"]
    classes: tuple[ClassMeaning, ...] = Field(min_length=2, description="In the order of outputs.")
    width: int = Field(ge=4, multiple_of=4, description="Channels of the first stage.")
    profile: SensorProfile = Field(description="Layout and normalisation of the range image.")
    residual: ResidualSettings | None = Field(default=None, description="LMNet's past frames.")
    attribution: str = Field(description="Where the training data came from.")
    data_license: str = Field(description="Licence of the training data.")
    training: dict[str, str | int | float] = Field(description="How the weights were made.")
    scores: dict[str, float] = Field(default={}, description="Measured when they were made.")

    def build(self) -> SalsaNext:
        """Build the network these weights belong to, with random parameters.

        Raises:
            WeightsUnusableError: If classes or residuals do not fit the network.
        """
        if (self.network == "lmnet") != (self.residual is not None):
            raise WeightsUnusableError(
                f"weights of {self.network} must name residuals if and only if it is lmnet"
            )
        if self.residual is None:
            return SalsaNext(classes=len(self.classes), width=self.width)
        net = LMNet(residuals=len(self.residual.ages_s), width=self.width)
        if len(self.classes) != net.logits.out_channels:
            raise WeightsUnusableError(
                f"lmnet has {net.logits.out_channels} classes, its weights name {len(self.classes)}"
            )
        return net


class LoadedWeights:
    """A network ready to answer, with what its weights say about themselves.

    Attributes:
        net: In evaluation mode, float32.
        card: The sidecar.
        digest: Hex sha256 of both files' bytes.
    """

    channels = CHANNELS

    def __init__(self, net: SalsaNext, card: WeightsCard, digest: str) -> None:
        self.net, self.card, self.digest = net, card, digest

    @property
    def profile(self) -> SensorProfile:
        """Layout and normalisation of the image."""
        return self.card.profile

    @property
    def residual(self) -> ResidualSettings | None:
        """The past frames that LMNet sees."""
        return self.card.residual

    @property
    def classes(self) -> tuple[ClassMeaning, ...]:
        """Meaning of each output. The first, "unlabelled", was never taught; LMNet tells motion."""
        tells_motion = self.card.network == "lmnet"
        return tuple(
            meaning.model_copy(
                update={"ignored": number == 0, "moving": tells_motion and number == MOVING}
            )
            for number, meaning in enumerate(self.card.classes)
        )

    def probabilities(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Map an image (C, H, W) to the probabilities of its classes (K, H, W)."""
        return run_eagerly(self.net, image)


def save_weights(path: Path, net: SalsaNext, card: WeightsCard) -> None:
    """Write weights as safetensors and their sidecar beside them.

    Convolution kernels are stored in half precision, everything else as it is: half the size, and
    the outputs move less than one rounding of the confidences.

    Args:
        path: The `.safetensors` file; the sidecar has the suffix `.json`.
        net: The trained network.
        card: What the weights belong to.
    """
    tensors = {
        key: (value.half() if value.ndim == 4 else value).contiguous().cpu()
        for key, value in net.state_dict().items()
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(safetensors.torch.save(tensors))
    path.with_suffix(".json").write_text(
        json.dumps(card.model_dump(mode="json"), indent=1) + "\n", encoding="utf-8"
    )


def load_weights(path: Path) -> LoadedWeights:
    """Load weights after checking that every parameter is there and fits; nothing is half loaded.

    Args:
        path: The `.safetensors` file, its sidecar beside it.

    Returns:
        The network in evaluation mode.

    Raises:
        WeightsUnusableError: If a file is missing or damaged, or keys or shapes differ; the message
            names the file and the first difference.
    """
    try:
        sidecar = path.with_suffix(".json").read_bytes()
        stored = path.read_bytes()
    except OSError as error:
        raise WeightsUnusableError(
            f"cannot read weights: {error.strerror or error}; a .safetensors and a .json file "
            f"of one name are needed ({error.filename or path})"
        ) from error
    try:
        card = WeightsCard.model_validate_json(sidecar)
    except ValidationError as error:
        first = error.errors()[0]
        raise WeightsUnusableError(
            f"weights' sidecar is not valid: {'.'.join(map(str, first['loc']))}: {first['msg']} "
            f"({path.with_suffix('.json')})"
        ) from error
    try:
        tensors = safetensors.torch.load(stored)
    except safetensors.SafetensorError as error:
        raise WeightsUnusableError(f"weights are damaged: {error} ({path})") from error
    net = card.build()
    _check(tensors, net.state_dict(), path)
    net.load_state_dict(
        {
            key: value.float() if value.is_floating_point() else value
            for key, value in tensors.items()
        }
    )
    net.eval()
    return LoadedWeights(net, card, hashlib.sha256(sidecar + stored).hexdigest())


def _check(stored: dict[str, torch.Tensor], expected: dict[str, torch.Tensor], path: Path) -> None:
    """Compare names and shapes before anything is loaded."""
    missing = [key for key in expected if key not in stored]
    if missing:
        raise WeightsUnusableError(
            f"weights lack {len(missing)} parameters, the first is {missing[0]} ({path})"
        )
    extra = sorted(key for key in stored if key not in expected)
    if extra:
        raise WeightsUnusableError(
            f"weights hold {len(extra)} parameters that the network has not, "
            f"the first is {extra[0]} ({path})"
        )
    for key, value in expected.items():
        if stored[key].shape != value.shape:
            raise WeightsUnusableError(
                f"weights of {key} are {tuple(stored[key].shape)}, the network needs "
                f"{tuple(value.shape)} ({path})"
            )
        if not torch.isfinite(stored[key].float()).all():
            raise WeightsUnusableError(f"weights of {key} are not all finite ({path})")
