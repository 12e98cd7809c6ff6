"""Data augmentation of training images: rotation, mirroring, jitter, dropped points and rows."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.lidar.range_image import CHANNELS, Channel, SensorProfile

TILT: Final = 0.008
"""Standard deviation of the mounting's slope, half a degree; a mast is less level than a roof.

Such a slope moves points by one row at most, which is neglected.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One image, raw (metres, intensity 0 to 1), with its labels.

    Attributes:
        channels: (5, H, W) range, x, y, z, intensity.
        residuals: (K, H, W) residual images.
        seen_mask: (H, W) true where a pixel shows a point.
        labels: (H, W) uint8.
    """

    channels: NDArray[np.float32]
    residuals: NDArray[np.float32]
    seen_mask: NDArray[np.bool_]
    labels: NDArray[np.uint8]


def augment(sample: Sample, rng: np.random.Generator, *, columns: int) -> Sample:
    """Rotate, mirror, jitter and thin out one image, then crop a window.

    Residuals and labels move with the pixels. Rows are dropped to imitate lidars with fewer beams;
    old residuals are blanked to imitate the start of a log.

    Args:
        sample: The whole image.
        rng: Random generator.
        columns: Width of the window.

    Returns:
        A new sample (H, columns).
    """
    channels, residuals = sample.channels.copy(), sample.residuals.copy()
    seen, labels = sample.seen_mask.copy(), sample.labels
    width = labels.shape[-1]
    shift = int(rng.integers(width))
    angle = -2 * np.pi * shift / width  # columns run clockwise: later columns, smaller azimuth
    x, y = channels[1].copy(), channels[2].copy()
    channels[1] = np.cos(angle) * x - np.sin(angle) * y
    channels[2] = np.sin(angle) * x + np.cos(angle) * y
    keep = np.roll(np.arange(width), shift)
    if rng.random() < 0.5:
        channels[2] *= -1
        keep = keep[::-1]
    keep = keep[:columns]
    channels, residuals = channels[..., keep], residuals[..., keep]
    seen, labels = seen[..., keep], labels[..., keep].copy()

    channels[3] += rng.normal(scale=0.15)  # mounting height
    tilt = rng.normal(scale=TILT, size=2).astype(np.float32)
    channels[3] += tilt[0] * channels[1] + tilt[1] * channels[2]
    scale = np.float32(1 + rng.normal(scale=0.02))
    channels[:4] *= scale
    channels[0] += rng.normal(scale=0.02, size=channels[0].shape)
    bright, gamma = rng.uniform(0.6, 1.6), rng.uniform(0.7, 1.4)
    channels[4] = np.clip(channels[4] * bright, 0, 1) ** gamma if rng.random() > 0.15 else 0
    if rng.random() < 0.5:
        seen &= rng.random(seen.shape) > rng.uniform(0, 0.3)
    if rng.random() < 0.2:
        step = int(rng.integers(2, 4))
        rows = np.arange(seen.shape[0]) % step == rng.integers(step)
        seen &= rows[:, None]
    if len(residuals) and rng.random() < 0.15:
        residuals[int(rng.integers(1, len(residuals) + 1)) :] = 0
    labels[~seen] = 0
    return Sample(channels, residuals, seen, labels)


def network_input(
    sample: Sample, profile: SensorProfile, channels: Sequence[Channel] = CHANNELS
) -> NDArray[np.float32]:
    """Normalise a sample as the stream does: residuals unchanged, empty pixels zero.

    Args:
        sample: Raw image.
        profile: Means and standard deviations.
        channels: Measurements that are input of the network.

    Returns:
        (C + K, H, W) float32.
    """
    means = np.asarray(profile.means, dtype=np.float32)[:, None, None]
    stds = np.asarray(profile.stds, dtype=np.float32)[:, None, None]
    seen = [CHANNELS.index(channel) for channel in channels]
    stacked = np.concatenate([((sample.channels - means) / stds)[seen], sample.residuals])
    return (stacked * sample.seen_mask).astype(np.float32)
