"""Elevation loss of GndNet, as published: smooth L1 error plus second-order smoothness."""

from typing import Final

from torch import Tensor
from torch.nn import functional

DATA_WEIGHT: Final = 0.9
SMOOTHNESS_WEIGHT: Final = 0.1


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
