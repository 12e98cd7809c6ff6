"""Go on from weights of a network that saw more: what it learnt of the shared channels is kept."""

from typing import Final

from torch import Tensor

from workers.checkpoints.errors import WeightsUnusableError
from workers.supervised.weights import LoadedWeights, WeightsCard

_FIRST: Final = "downCntx.conv1.weight"
"""The only kernel that reads the image."""


def started(initial: LoadedWeights, card: WeightsCard) -> dict[str, Tensor]:
    """Fit weights to a network that sees fewer of the measurements.

    A measurement that is no longer seen counts as if it always were at its mean: its kernel is
    left out, and nothing else changes. This holds only where both normalise alike.

    Args:
        initial: Weights to go on from.
        card: Of the network that is to learn.

    Returns:
        Every parameter of that network.

    Raises:
        WeightsUnusableError: If anything but the choice of measurements differs.
    """
    before = initial.card
    same = ("network", "classes", "width", "residual")
    if any(getattr(before, what) != getattr(card, what) for what in same):
        raise WeightsUnusableError(
            f"initial weights must agree with what is trained in {', '.join(same)}"
        )
    if unknown := [channel for channel in card.channels if channel not in before.channels]:
        raise WeightsUnusableError(f"initial weights do not know {', '.join(unknown)}")
    if (before.profile.means, before.profile.stds) != (card.profile.means, card.profile.stds):
        raise WeightsUnusableError("initial weights must be normalised alike")
    residuals = 0 if before.residual is None else len(before.residual.ages_s)
    kept = [before.channels.index(channel) for channel in card.channels]
    kept += [len(before.channels) + age for age in range(residuals)]
    parameters: dict[str, Tensor] = initial.net.state_dict()
    return parameters | {_FIRST: parameters[_FIRST][:, kept]}
