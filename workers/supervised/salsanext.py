"""SalsaNext: semantic segmentation of range images, with the published names of its parameters.

Source: Cortinhal, Tzelepis, Aksoy, "SalsaNext: Fast, Uncertainty-aware Semantic Segmentation of
LiDAR Point Clouds for Autonomous Driving", 2020. Every convolution has a bias and is followed by
LeakyReLU and then batch normalisation, in that order. The network works at any width: `width`
channels at the first stage (published: 32), two, four and eight times as many further down.
"""

from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

SLOPE: Final = 0.01
"""Slope of LeakyReLU, published."""


def _act(x: Tensor) -> Tensor:
    return functional.leaky_relu(x, SLOPE, inplace=not torch.is_grad_enabled())


class ResContextBlock(nn.Module):
    """Widens the receptive field with dilated convolutions at full resolution."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 1)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv3 = nn.Conv2d(outputs, outputs, 3, dilation=2, padding=2)
        self.bn2 = nn.BatchNorm2d(outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, inputs, H, W) to (B, outputs, H, W)."""
        shortcut = _act(self.conv1(x))
        near = self.bn1(_act(self.conv2(shortcut)))
        wide: Tensor = self.bn2(_act(self.conv3(near)))
        return shortcut + wide


class ResBlock(nn.Module):
    """Encoder step: three kernels of growing receptive field, then halves the image."""

    def __init__(
        self, inputs: int, outputs: int, *, dropout: float, drop: bool = True, pool: bool = True
    ) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 1)
        self.conv2 = nn.Conv2d(inputs, outputs, 3, padding=1)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv3 = nn.Conv2d(outputs, outputs, 3, dilation=2, padding=2)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.conv4 = nn.Conv2d(outputs, outputs, 2, dilation=2, padding=1)
        self.bn3 = nn.BatchNorm2d(outputs)
        self.conv5 = nn.Conv2d(3 * outputs, outputs, 1)
        self.bn4 = nn.BatchNorm2d(outputs)
        self.dropout = nn.Dropout2d(dropout if drop else 0.0)
        self.pool = nn.AvgPool2d(3, stride=2, padding=1) if pool else nn.Identity()

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Map (B, inputs, H, W) to the next stage's input and the skip at this resolution."""
        first = self.bn1(_act(self.conv2(x)))
        second = self.bn2(_act(self.conv3(first)))
        third = self.bn3(_act(self.conv4(second)))
        merged = self.bn4(_act(self.conv5(torch.cat((first, second, third), dim=1))))
        skip = _act(self.conv1(x)) + merged
        return self.pool(self.dropout(skip)), skip


class UpBlock(nn.Module):
    """Decoder step: doubles the image by pixel shuffling and concatenates the encoder's skip."""

    def __init__(self, inputs: int, skips: int, outputs: int, *, dropout: float) -> None:
        super().__init__()
        self.drop1 = nn.Dropout2d(dropout)
        self.drop2 = nn.Dropout2d(dropout)
        self.conv1 = nn.Conv2d(inputs // 4 + skips, outputs, 3, padding=1)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, dilation=2, padding=2)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.conv3 = nn.Conv2d(outputs, outputs, 2, dilation=2, padding=1)
        self.bn3 = nn.BatchNorm2d(outputs)
        self.conv4 = nn.Conv2d(3 * outputs, outputs, 1)
        self.bn4 = nn.BatchNorm2d(outputs)
        self.drop3 = nn.Dropout2d(dropout)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        """Map (B, inputs, H, W) and (B, skips, 2H, 2W) to (B, outputs, 2H, 2W)."""
        raised = self.drop1(functional.pixel_shuffle(x, 2))
        joined = self.drop2(torch.cat((raised, skip), dim=1))
        first = self.bn1(_act(self.conv1(joined)))
        second = self.bn2(_act(self.conv2(first)))
        third = self.bn3(_act(self.conv3(second)))
        merged = self.bn4(_act(self.conv4(torch.cat((first, second, third), dim=1))))
        out: Tensor = self.drop3(merged)
        return out


class SalsaNext(nn.Module):
    """The whole network: three context blocks, five encoder and four decoder steps.

    Args:
        in_channels: Channels of the input: range, x, y, z, intensity, and residuals for LMNet.
        classes: Classes of the output; class 0 is "unlabelled".
        width: Channels of the first stage; 32 as published, a multiple of 4.
        dropout: Share of channels dropped in training; 0.2 as published.

    Raises:
        ValueError: If the width is not a positive multiple of 4 (pixel shuffling needs it).
    """

    def __init__(
        self, *, in_channels: int = 5, classes: int = 20, width: int = 32, dropout: float = 0.2
    ) -> None:
        super().__init__()
        if width < 4 or width % 4:
            raise ValueError(f"width of SalsaNext must be a positive multiple of 4, got {width}")
        w = width
        self.downCntx = ResContextBlock(in_channels, w)
        self.downCntx2 = ResContextBlock(w, w)
        self.downCntx3 = ResContextBlock(w, w)
        self.resBlock1 = ResBlock(w, 2 * w, dropout=dropout, drop=False)
        self.resBlock2 = ResBlock(2 * w, 4 * w, dropout=dropout)
        self.resBlock3 = ResBlock(4 * w, 8 * w, dropout=dropout)
        self.resBlock4 = ResBlock(8 * w, 8 * w, dropout=dropout)
        self.resBlock5 = ResBlock(8 * w, 8 * w, dropout=dropout, pool=False)
        self.upBlock1 = UpBlock(8 * w, 8 * w, 4 * w, dropout=dropout)
        self.upBlock2 = UpBlock(4 * w, 8 * w, 4 * w, dropout=dropout)
        self.upBlock3 = UpBlock(4 * w, 4 * w, 2 * w, dropout=dropout)
        self.upBlock4 = UpBlock(2 * w, 2 * w, w, dropout=0.0)
        self.logits = nn.Conv2d(w, classes, 1)

    def forward_logits(self, x: Tensor) -> Tensor:
        """Score every class in every pixel.

        Args:
            x: (B, in_channels, H, W) normalised; H and W multiples of 16.

        Returns:
            (B, classes, H, W) unnormalised scores.
        """
        x = self.downCntx3(self.downCntx2(self.downCntx(x)))
        x, skip1 = self.resBlock1(x)
        x, skip2 = self.resBlock2(x)
        x, skip3 = self.resBlock3(x)
        x, skip4 = self.resBlock4(x)
        x, _ = self.resBlock5(x)
        x = self.upBlock1(x, skip4)
        x = self.upBlock2(x, skip3)
        x = self.upBlock3(x, skip2)
        x = self.upBlock4(x, skip1)
        scores: Tensor = self.logits(x)
        return scores

    def forward(self, x: Tensor) -> Tensor:
        """Return the probability of every class in every pixel; softmax inside, as published.

        Args:
            x: (B, in_channels, H, W) normalised; H and W multiples of 16.

        Returns:
            (B, classes, H, W) that sum to 1 over the classes.
        """
        return functional.softmax(self.forward_logits(x), dim=1)
