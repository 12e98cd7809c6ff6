"""Segmentation loss of SalsaNext and LMNet, as published: weighted log loss plus Lovász-softmax."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

IGNORED = 0
"""Class of pixels excluded from the loss: unlabelled or empty."""


def class_weights(drawn: NDArray[np.floating], *, balance: float = 1.0) -> Tensor:
    """Return class weights that are high for rare classes: ``1 / (share + 0.001)``, ignored ones 0.

    Args:
        drawn: (classes,) frequency of each class, up to a common factor.
        balance: Exponent of the weights: 1 as published, 0 for none. With few frames, the published
            weights make a small network label pedestrians everywhere.

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
    """Return the sum of both losses, as in the training of SalsaNext and LiDAR-MOS.

    Args:
        logits: (B, C, H, W) scores before softmax.
        labels: (B, H, W) int64; `IGNORED` pixels count for neither loss.
        weights: (C,) weight of each class in the log loss, zero for the ignored one.
        lovasz_every: Every n-th pixel counts for the Lovász loss; sorting all of them takes longer
            than the network's forward pass.

    Returns:
        Scalar; zero when every pixel is ignored.
    """
    if not bool((labels != IGNORED).any()):
        return logits.sum() * 0
    shares = functional.softmax(logits, dim=1)
    log_loss = functional.nll_loss(torch.log(shares.clamp(min=1e-8)), labels, weight=weights)
    return log_loss + lovasz_softmax(shares, labels, every=lovasz_every)


def lovasz_softmax(shares: Tensor, labels: Tensor, *, every: int = 1) -> Tensor:
    """Return a smooth surrogate of one minus the mean IoU of the classes present.

    Source: Berman, Rannen Triki, Blaschko, "The Lovász-Softmax loss", CVPR 2018, algorithm 1.

    Args:
        shares: (B, C, H, W) softmax output.
        labels: (B, H, W) int64; `IGNORED` pixels are left out.
        every: Every n-th of the others counts.

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
    """Return the loss of IoU with each further error, worst first."""
    total = sorted_truth.sum()
    intersection = total - sorted_truth.cumsum(0)
    union = total + (1 - sorted_truth).cumsum(0)
    jaccard = 1 - intersection / union
    return torch.cat((jaccard[:1], jaccard[1:] - jaccard[:-1]))
