"""Warm start: continues from weights of a network with more input channels."""

from pathlib import Path
from typing import Final

from torch import Tensor

from workers.checkpoints.errors import WeightsUnusableError
from workers.supervised.weights import LoadedWeights, WeightsCard

_FIRST: Final = "downCntx.conv1.weight"
"""The only kernel that reads the image."""


def warm_start_parameters(initial: LoadedWeights, card: WeightsCard) -> dict[str, Tensor]:
    """Convert weights to a network with fewer input channels.

    A removed channel counts as if it were always at its mean: its kernel is dropped, and nothing
    else changes. This is exact only where both networks normalise in the same way.

    Args:
        initial: Weights to continue from.
        card: Card of the network to train.

    Returns:
        Every parameter of that network.

    Raises:
        WeightsUnusableError: If anything but the choice of channels differs.
    """
    before = initial.card
    same = ("network", "classes", "width", "residual")
    if any(getattr(before, what) != getattr(card, what) for what in same):
        raise WeightsUnusableError(
            f"initial weights and the trained network must agree in {', '.join(same)}"
        )
    if unknown := [channel for channel in card.channels if channel not in before.channels]:
        raise WeightsUnusableError(f"initial weights lack the channels {', '.join(unknown)}")
    if (before.profile.means, before.profile.stds) != (card.profile.means, card.profile.stds):
        raise WeightsUnusableError("initial weights must have the same normalisation")
    residuals = 0 if before.residual is None else len(before.residual.ages_s)
    kept = [before.channels.index(channel) for channel in card.channels]
    kept += [len(before.channels) + age for age in range(residuals)]
    parameters: dict[str, Tensor] = initial.net.state_dict()
    return parameters | {_FIRST: parameters[_FIRST][:, kept]}


def file_of(initial: Path, network: str) -> Path:
    """Return the weights of a network in a folder, or the file itself."""
    return initial / f"{network}.safetensors" if initial.is_dir() else initial
