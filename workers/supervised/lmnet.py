"""LMNet: motion segmentation, the SalsaNext body with residual images as further input channels.

Source: Chen et al., "Moving Object Segmentation in 3D LiDAR Data: A Learning-based Approach
Exploiting Sequential Data" (LiDAR-MOS), RA-L 2021, SalsaNext variant.
"""

from typing import Final

from workers.lidar.range_image import CHANNELS
from workers.supervised.salsanext import SalsaNext

MOTION_CLASSES: Final = ("unlabeled", "static", "moving")
"""Meaning of the three outputs; published order."""

MOVING: Final = MOTION_CLASSES.index("moving")


class LMNet(SalsaNext):
    """SalsaNext over a range image and its residuals against past frames.

    Args:
        measured: Number of channels of the current frame.
        residuals: Number of past frames; 8 in the paper, 1 in its small variant.
        width: Channels of the first stage; 32 as published.
        dropout: Share of channels dropped in training; 0.2 as published.
    """

    def __init__(
        self,
        *,
        measured: int = len(CHANNELS),
        residuals: int = 8,
        width: int = 32,
        dropout: float = 0.2,
    ) -> None:
        super().__init__(
            in_channels=measured + residuals,
            classes=len(MOTION_CLASSES),
            width=width,
            dropout=dropout,
        )
