"""Monte-Carlo dropout: per-pixel epistemic uncertainty of a range image network."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from workers.supervised.salsanext import SalsaNext


@dataclass(frozen=True, slots=True)
class McDropout:
    """Mean and variance over several passes with random dropout.

    Attributes:
        mean: (B, classes, H, W) mean of the probabilities; sums to 1 over the classes.
        uncertainty: (B, H, W) variance over the passes of the probability of the most probable
            class in the mean; 0 to 0.25, no unit.
    """

    mean: Tensor
    uncertainty: Tensor


def mc_dropout(net: SalsaNext, images: Tensor, *, passes: int = 30, seed: int = 0) -> McDropout:
    """Run a network several times, each time without a random share of its channels.

    The epistemic uncertainty of SalsaNext (Cortinhal et al., 2020, section III-B; Gal, Ghahramani,
    ICML 2016): dropout stays on, everything else is as in evaluation, and the spread of the outputs
    is the uncertainty. Two differences from the published script: the class is that of the mean,
    not the one that won most passes, and no pass is discarded before the first.

    Args:
        net: Network with a dropout share above 0; its mode is restored.
        images: (B, in_channels, H, W) normalised.
        passes: Number of passes; published 30.
        seed: Seed of the dropout; results repeat on the same device.

    Returns:
        Mean and uncertainty.

    Raises:
        ValueError: If there are fewer than two passes, or nothing to drop.
    """
    dropouts = [module for module in net.modules() if isinstance(module, nn.Dropout2d)]
    if passes < 2 or not any(module.p > 0 for module in dropouts):
        raise ValueError(
            "uncertainty needs at least two passes and a network with dropout, got "
            f"{passes} passes and dropout {max((module.p for module in dropouts), default=0.0)}"
        )
    devices = [images.device] if images.device.type == "cuda" else []
    with torch.random.fork_rng(devices=devices), _only_dropout(net, dropouts), torch.no_grad():
        torch.manual_seed(seed)
        mean = net(images)
        spread = torch.zeros_like(mean)
        for done in range(1, passes):
            answer = net(images)
            before = answer - mean
            mean += before / (done + 1)
            spread += before * (answer - mean)
    likeliest = mean.argmax(dim=1, keepdim=True)
    return McDropout(mean, (spread / passes).gather(1, likeliest)[:, 0])


@contextmanager
def _only_dropout(net: nn.Module, dropouts: list[nn.Dropout2d]) -> Iterator[None]:
    """Enable dropout, and normalise by the learned statistics; restore every mode at the end."""
    modes = [(module, module.training) for module in net.modules()]
    net.eval()
    for dropout in dropouts:
        dropout.train()
    try:
        yield
    finally:
        for module, mode in modes:
            module.training = mode
