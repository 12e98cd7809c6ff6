"""Settings of a training run of a network over range images."""

from dataclasses import dataclass, replace
from typing import Final, Literal

PRESETS: Final = ("default", "published")


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """Settings of a training run, in addition to its data.

    Attributes:
        steps: Optimiser steps of the schedule.
        balance: Exponent of the class weights.
        batch: Windows per step.
        driving_weight: Factor by which frames of a driving car are drawn more often.
        columns: Width of a window; wider than the image: the whole image.
        peak_rate: Highest learning rate of the schedule.
        weight_decay: Weight decay of the optimiser.
        dropout: Share of channels dropped.
        fixed_norms: Share of the steps, the last ones, that normalise by the running means and
            deviations, as in use. Sensors differ so much that batch statistics flatter the scores:
            a network first learns with them, and then adapts to the statistics of all sensors.
        norm_momentum: Momentum of the batch norm's running means; 0.02 are some fifty batches,
            since one has few sensors.
        lovasz_every: Every n-th labelled pixel counts for the Lovász loss.
        bfloat16: Convolve in bfloat16, a third faster on a processor that supports it.
        published: Augmentation and schedule of the publications: SGD, one epoch of linear
            warm-up, then a hundredth less with each epoch.
        epoch: Steps of an epoch of the published schedule.
        scorings: Number of scorings on held-out data, evenly spaced.
        patience: Scorings without a better score after which a run stops; 0: never.
        seed: Seed of everything random.
        threads: Threads of torch; another number gives other weights.
        device: `cpu` or `cuda`.
    """

    steps: int = 2400
    batch: int = 2
    driving_weight: float = 2.0
    columns: int = 512
    balance: float = 0.5
    peak_rate: float = 4e-3
    weight_decay: float = 1e-3
    dropout: float = 0.02
    fixed_norms: float = 0.0
    norm_momentum: float = 0.02
    lovasz_every: int = 1
    bfloat16: bool = False
    published: bool = False
    epoch: int = 1
    scorings: int = 10
    patience: int = 0
    seed: int = 1
    threads: int = 1
    device: Literal["cpu", "cuda"] = "cpu"


def published_settings(settings: TrainingSettings, *, images: int, epochs: int) -> TrainingSettings:
    """Return the published schedule of SalsaNext and LMNet for a number of training images.

    Source: the training code of SalsaNext (Cortinhal et al., 2020) and LiDAR-MOS (Chen et al.,
    RA-L 2021): SGD with momentum 0.9, rate 0.01, weight decay 1e-4, 24 images a step, 150 epochs,
    weighted log loss plus Lovász-softmax of all pixels, dropout 0.2.

    Args:
        settings: Seed, threads, device and scorings are kept.
        images: Training images of an epoch.
        epochs: Number of epochs; 150 as published.
    """
    batch = min(PUBLISHED_BATCH, images)
    epoch = max(-(-images // batch), 1)
    return replace(
        settings,
        steps=epochs * epoch,
        epoch=epoch,
        batch=batch,
        driving_weight=1.0,
        columns=1 << 20,
        balance=1.0,
        peak_rate=0.01,
        weight_decay=1e-4,
        dropout=0.2,
        fixed_norms=0.0,
        norm_momentum=0.1,
        lovasz_every=1,
        published=True,
    )


PUBLISHED_BATCH: Final = 24
"""Images of a step in the published training."""

PUBLISHED_EPOCHS: Final = 150
"""Epochs of the published training."""

PUBLISHED_WIDTH: Final = 32
"""Channels of the first stage of the published networks."""
