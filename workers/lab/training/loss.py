"""The published loss of SalsaNext and LMNet: weighted log loss plus Lovász-softmax."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

IGNORED = 0
"""Class of pixels that nothing is learnt from: unlabelled or empty."""


def class_weights(drawn: NDArray[np.floating], *, balance: float = 1.0) -> Tensor:
    """Weight rare classes up: ``1 / (share + 0.001)``, nothing for the ignored class.

    Args:
        drawn: (classes,) how often each is drawn, or a number in proportion.
        balance: Exponent of the weights: 1 as published, 0 for none. With few frames the published
            ones make a small network see pedestrians everywhere.

    Returns:
        (classes,) float32.
    """
    counts = torch.tensor(drawn, dtype=torch.float64)
    counts[IGNORED] = 0
    weights = (1 / (counts / counts.sum() + 0.001)) ** balance
    weights[IGNORED] = 0
    return weights.float()


def segmentation_loss(
    logits: Tensor, labels: Tensor, weights: Tensor, *, lovasz_every: int = 1
) -> Tensor:
    """Sum of both losses, as SalsaNext and LiDAR-MOS are trained.

    Args:
        logits: (B, C, H, W) scores before softmax.
        labels: (B, H, W) int64; `IGNORED` pixels count for neither loss.
        weights: (C,) weight of each class in the log loss, zero for the ignored one.
        lovasz_every: Only each that many-th pixel counts for the Lovász loss, whose sorting takes
            longer than the network's answer where all do.

    Returns:
        Scalar.
    """
    shares = functional.softmax(logits, dim=1)
    log_loss = functional.nll_loss(torch.log(shares.clamp(min=1e-8)), labels, weight=weights)
    return log_loss + lovasz_softmax(shares, labels, every=lovasz_every)


def lovasz_softmax(shares: Tensor, labels: Tensor, *, every: int = 1) -> Tensor:
    """Smooth stand-in for one minus the mean IoU of the classes present.

    Source: Berman, Rannen Triki, Blaschko, "The Lovász-Softmax loss", CVPR 2018, algorithm 1.

    Args:
        shares: (B, C, H, W) softmax output.
        labels: (B, H, W) int64; `IGNORED` pixels are left out.
        every: Of the others, each that many-th counts.

    Returns:
        Scalar; zero when every pixel is ignored.
    """
    counted = labels != IGNORED
    flat_shares = shares.movedim(1, -1)[counted][::every]
    flat_labels = labels[counted][::every]
    losses = []
    for class_id in torch.unique(flat_labels).tolist():
        truth = (flat_labels == class_id).float()
        errors, order = torch.sort((truth - flat_shares[:, class_id]).abs(), descending=True)
        losses.append(torch.dot(errors, _jaccard_steps(truth[order])))
    return torch.stack(losses).mean() if losses else shares.sum() * 0


def _jaccard_steps(sorted_truth: Tensor) -> Tensor:
    """How much each further error, worst first, costs in IoU."""
    total = sorted_truth.sum()
    intersection = total - sorted_truth.cumsum(0)
    union = total + (1 - sorted_truth).cumsum(0)
    jaccard = 1 - intersection / union
    return torch.cat((jaccard[:1], jaccard[1:] - jaccard[:-1]))
