"""Elevation losses of GndNet: smooth L1 error plus second-order smoothness, published and ours."""

from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

DATA_WEIGHT: Final = 0.9
SMOOTHNESS_WEIGHT: Final = 0.1

BEND_M: Final = 0.05
"""Error at which our loss turns from square to linear, metres: the accuracy asked for.

The published loss turns at 1 m. Below it the gradient falls with the error, and a cell filled far
outside, 1 m off, outweighs a hundred cells with ground that are 0.1 m off."""

UNSEEN_WEIGHT: Final = 0.02
"""Weight of a cell without ground points in our loss.

Four of five cells are such. Beyond the outermost ground their height is that of the nearest cell,
which no tilted road has. With a tenth they still had most of the loss."""


def elevation_loss(elevation_m: Tensor, truth_m: Tensor) -> Tensor:
    """Return the weighted sum of error and smoothness.

    Args:
        elevation_m: (B, H, W) output of the network.
        truth_m: (B, H, W) true elevation.

    Returns:
        Scalar.
    """
    close = functional.smooth_l1_loss(elevation_m, truth_m)
    return DATA_WEIGHT * close + SMOOTHNESS_WEIGHT * second_order_smoothness(elevation_m)


def seen_elevation_loss(elevation_m: Tensor, truth_m: Tensor, seen: Tensor) -> Tensor:
    """Return the weighted sum of error and smoothness, mostly of cells with ground points.

    Args:
        elevation_m: (B, H, W) output of the network.
        truth_m: (B, H, W) true elevation.
        seen: (B, H, W) bool, cells with ground points.

    Returns:
        Scalar.
    """
    weight = torch.where(seen, 1.0, UNSEEN_WEIGHT)
    error = functional.smooth_l1_loss(elevation_m, truth_m, beta=BEND_M, reduction="none")
    close = (weight * error).sum() / weight.sum()
    return DATA_WEIGHT * close + SMOOTHNESS_WEIGHT * second_order_smoothness(elevation_m)


def second_order_smoothness(elevation_m: Tensor) -> Tensor:
    """Return the mean absolute second difference along x, along y and across, the latter twice.

    Args:
        elevation_m: (B, H, W).

    Returns:
        Scalar; zero for a plane of any slope.
    """
    along_x, along_y = _difference(elevation_m, 2), _difference(elevation_m, 1)
    return (
        _difference(along_x, 2).abs().mean()
        + _difference(along_x, 1).abs().mean()
        + _difference(along_y, 2).abs().mean()
        + _difference(along_y, 1).abs().mean()
    )


def _difference(image: Tensor, dim: int) -> Tensor:
    return image.narrow(dim, 1, image.shape[dim] - 1) - image.narrow(dim, 0, image.shape[dim] - 1)
