"""Batches of windows, drawn from the training images of several sensors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from workers.lab.datasets.images import TrainingImages
from workers.lab.training.augment import Sample, augment, network_input
from workers.lab.training.loss import IGNORED
from workers.lab.training.published_augmentation import published_augment
from workers.lab.training.settings import TrainingSettings
from workers.lidar.range_image import SensorProfile
from workers.supervised.weights import WeightsCard

DRIVING_M_PER_S = 0.5
"""Ego speed from which the car drives, m/s: static objects then look different in every frame."""


@dataclass(frozen=True, slots=True, eq=False)
class TrainingSet:
    """Training images of one sensor, with their sampling weight.

    Attributes:
        images: Images of one layout.
        weight: Sampling weight relative to the other sensors.
        proved: The classes are only 1, cannot move, and 2, can move, where the self-supervised
            stream proved it; 0 elsewhere. They teach which classes can move together, and none.
        layout: Layout of the images; the published augmentation projects points again.
    """

    images: TrainingImages
    weight: float
    proved: bool = False
    layout: SensorProfile | None = None

    def labels(self, card: WeightsCard) -> NDArray[np.uint8]:
        """Return the labels that a network learns from."""
        return self.images.semantic if card.network == "salsanext" else self.images.motion


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Windows of several sensors with equally many rows.

    Attributes:
        inputs: (B, C, H, W) float32, normalised.
        labels: (B, H, W) int64 classes.
        proved: (B,) windows whose labels are of a `TrainingSet` that is `proved`.
    """

    inputs: Tensor
    labels: Tensor
    proved: Tensor

    def to(self, device: str) -> "Batch":
        """Copy the batch to a device; itself on the CPU."""
        return Batch(self.inputs.to(device), self.labels.to(device), self.proved.to(device))


def draw_batch(
    training_sets: Sequence[TrainingSet],
    card: WeightsCard,
    settings: TrainingSettings,
    rng: np.random.Generator,
) -> Batch:
    """Draw windows of several sensors with equally many rows."""
    inputs, targets, proved = [], [], []
    drawable = list(training_sets)
    for _ in range(settings.batch):
        weights = np.array([training_set.weight for training_set in drawable])
        chosen = drawable[int(rng.choice(len(drawable), p=weights / weights.sum()))]
        images = chosen.images
        rows = images.channels.shape[2]
        drawable = [each for each in training_sets if each.images.channels.shape[2] == rows]
        drives = images.ego_speed_m_per_s > DRIVING_M_PER_S
        share = np.where(drives, settings.driving_weight, 1.0)
        labels = chosen.labels(card)
        number = int(rng.choice(len(labels), p=share / share.sum()))
        sample = Sample(
            images.channels[number].astype(np.float32),
            images.residuals[number, int(rng.integers(images.residuals.shape[1]))].astype(
                np.float32
            )
            if card.residual
            else np.zeros((0, *labels.shape[1:]), dtype=np.float32),
            images.seen_mask[number],
            labels[number],
        )
        changed = _augmentation(chosen, settings)(sample, rng)
        inputs.append(network_input(changed, card.profile, card.channels))
        targets.append(changed.labels.astype(np.int64))
        proved.append(chosen.proved)
    x = torch.from_numpy(np.stack(inputs)).contiguous(memory_format=torch.channels_last)
    return Batch(x, torch.from_numpy(np.stack(targets)), torch.tensor(proved))


def _augmentation(
    chosen: TrainingSet, settings: TrainingSettings
) -> Callable[[Sample, np.random.Generator], Sample]:
    layout = chosen.layout
    if settings.published and layout is not None:
        return lambda sample, rng: published_augment(sample, rng, layout=layout)
    return lambda sample, rng: augment(sample, rng, columns=settings.columns)


def drawn_labels(
    training_sets: Sequence[TrainingSet], card: WeightsCard, classes: int
) -> NDArray[np.float64]:
    """Return the frequency of each class in the drawn images, as shares of labelled pixels."""
    drawn = np.zeros(classes)
    for training_set in training_sets:
        counts = np.bincount(training_set.labels(card).ravel(), minlength=classes)
        counts[IGNORED] = 0
        drawn += training_set.weight * counts / max(counts.sum(), 1)
    return drawn
