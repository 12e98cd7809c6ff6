"""DeLORA: learned lidar odometry, trained without labels.

Source: Nubert, Khattak, Hutter, "Self-supervised Learning of LiDAR Odometry for Robotic
Applications", ICRA 2021, section III-B (network); BSD-3-Clause code, published parameter names.
"""

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from workers.lidar.fidelity import Form

IMAGE_CHANNELS: Final = ("x", "y", "z", "range")
"""Channels of each of the two images, metres, zero in empty pixels; not normalised."""

_FEATURES: Final = 1000
_HIDDEN: Final = 100


@dataclass(frozen=True, slots=True)
class Motion:
    """Estimated motion of each pair of frames.

    Attributes:
        translation_m: (B, 3) metres.
        quaternion_xyzw: (B, 4) rotation, the real part last.
        this_from_next: (B, 4, 4) maps points of the second frame into the space of the first.
    """

    translation_m: Tensor
    quaternion_xyzw: Tensor
    this_from_next: Tensor


def _wrap(x: Tensor) -> Tensor:
    """Pad the image circularly: its left and right edges are neighbours."""
    return functional.pad(x, (1, 1, 0, 0), mode="circular")


class BasicBlock(nn.Module):
    """Two convolutions around a shortcut, without normalisation."""

    def __init__(self, inputs: int, outputs: int, *, stride: tuple[int, int]) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride=stride, padding=(1, 0), bias=False)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=(1, 0), bias=False)
        self.downsample = (
            nn.Identity()
            if stride == (1, 1) and inputs == outputs
            else nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride=stride, bias=False))
        )

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, inputs, H, W) to (B, outputs, H / stride, W / stride)."""
        inner = torch.tanh(self.conv1(_wrap(x)))
        outer: Tensor = self.conv2(_wrap(inner))
        return torch.tanh(outer + self.downsample(x))


class ResNet(nn.Module):
    """ResNet-18 on panoramas: the image keeps its height until the last stage."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(
            2 * len(IMAGE_CHANNELS), 64, 3, stride=(1, 2), padding=(1, 0), bias=False
        )
        self.maxpool = nn.MaxPool2d(3, stride=(1, 2), padding=(1, 0))
        self.layer1 = _stage(64, 64, stride=(1, 1))
        self.layer2 = _stage(64, 128, stride=(1, 2))
        self.layer3 = _stage(128, 256, stride=(1, 2))
        self.layer4 = _stage(256, 512, stride=(2, 2))
        self.fc = nn.Linear(512, _FEATURES)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, 8, H, W) to (B, 1000)."""
        x = torch.tanh(self.conv1(_wrap(x)))
        x = self.maxpool(_wrap(x))
        x = self.layer4(self.layer3(self.layer2(self.layer1(x))))
        features: Tensor = self.fc(x.mean(dim=(2, 3)))
        return features


def _stage(inputs: int, outputs: int, *, stride: tuple[int, int]) -> nn.Sequential:
    return nn.Sequential(
        BasicBlock(inputs, outputs, stride=stride), BasicBlock(outputs, outputs, stride=(1, 1))
    )


class DeLORA(nn.Module):
    """Odometry from two range images.

    Args:
        form: Corrected: each quaternion has length 1. Paper: the published code divides by the norm
            over the whole batch, so that quaternions of a batch of two or more are shorter.
            The matrix is the same: it is built from each quaternion at length 1.
    """

    def __init__(self, *, form: Form = Form.CORRECTED) -> None:
        super().__init__()
        self.form = form
        self.resnet = ResNet()
        self.fully_connected_rotation = _head(4)
        self.fully_connected_translation = _head(3)

    def forward(self, image: Tensor, next_image: Tensor) -> Motion:
        """Estimate the motion of the sensor.

        Args:
            image: (B, 4, H, W) first frame, channels of `IMAGE_CHANNELS`; 64 x 720 as published.
            next_image: (B, 4, H, W) second frame.

        Returns:
            Translation, rotation and both as a matrix.
        """
        return self.motion_of(self.resnet(torch.cat((image, next_image), dim=1)))

    def motion_of(self, features: Tensor) -> Motion:
        """Estimate the motion from (B, 1000) features of both images."""
        translation: Tensor = self.fully_connected_translation(features)
        raw: Tensor = self.fully_connected_rotation(features)
        unit = raw / raw.norm(dim=1, keepdim=True)
        return Motion(
            translation_m=translation,
            quaternion_xyzw=unit if self.form is Form.CORRECTED else raw / raw.norm(),
            this_from_next=matrix(translation, unit),
        )


def _head(outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Tanh(), nn.Linear(_FEATURES, _HIDDEN), nn.Tanh(), nn.Linear(_HIDDEN, outputs)
    )


def matrix(translation_m: Tensor, quaternion_xyzw: Tensor) -> Tensor:
    """Build rigid transforms.

    Args:
        translation_m: (B, 3).
        quaternion_xyzw: (B, 4) of length 1, the real part last.

    Returns:
        (B, 4, 4).
    """
    x, y, z, w = quaternion_xyzw.unbind(dim=1)
    built = torch.zeros(len(w), 4, 4, dtype=w.dtype, device=w.device)
    built[:, 0, 0] = 1 - 2 * (y * y + z * z)
    built[:, 0, 1] = 2 * (x * y - z * w)
    built[:, 0, 2] = 2 * (x * z + y * w)
    built[:, 1, 0] = 2 * (x * y + z * w)
    built[:, 1, 1] = 1 - 2 * (x * x + z * z)
    built[:, 1, 2] = 2 * (y * z - x * w)
    built[:, 2, 0] = 2 * (x * z - y * w)
    built[:, 2, 1] = 2 * (y * z + x * w)
    built[:, 2, 2] = 1 - 2 * (x * x + y * y)
    built[:, :3, 3] = translation_m
    built[:, 3, 3] = 1
    return built
