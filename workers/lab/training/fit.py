"""Training loop of one segmentation network: schedule, batches, periodic scores."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from torch import Tensor

from workers.lab.datasets.images import TrainingImages
from workers.lab.training.augment import Sample, augment, network_input
from workers.lab.training.loss import IGNORED, class_weights, segmentation_loss
from workers.lab.training.scores import score_images
from workers.lab.training.warm_start import warm_start_parameters
from workers.supervised.salsanext import SalsaNext
from workers.supervised.weights import LoadedWeights, WeightsCard, save_weights

log = logging.getLogger(__name__)

DRIVING_M_PER_S: Final = 0.5
"""Ego speed from which the car drives, m/s: static objects then look different in every frame."""

_SCORED_EVERY: Final = 1000

_NORM_MOMENTUM: Final = 0.02
"""Momentum of the batch norm's running means: some fifty batches, since one has few sensors."""


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """Settings of a training run, in addition to its data.

    Attributes:
        steps: Optimiser steps of the schedule.
        balance: Exponent of the class weights.
        batch: Windows per step.
        driving_weight: Factor by which frames of a driving car are drawn more often.
        columns: Width of a window.
        peak_rate: Highest learning rate of the one-cycle schedule.
        weight_decay: Weight decay of AdamW.
        dropout: Share of channels dropped.
        fixed_norms: Share of the steps, the last ones, that normalise by the running means and
            deviations, as in use. Sensors differ so much that batch statistics flatter the scores:
            a network first learns with them, and then adapts to the statistics of all sensors.
        lovasz_every: Every n-th labelled pixel counts for the Lovász loss.
        bfloat16: Convolve in bfloat16, a third faster on a processor that supports it.
        seed: Seed of everything random.
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
    lovasz_every: int = 1
    bfloat16: bool = False
    seed: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class TrainingSet:
    """Training images of one sensor, with their sampling weight.

    Attributes:
        images: Images of one layout.
        weight: Sampling weight relative to the other sensors.
    """

    images: TrainingImages
    weight: float


def train(
    training_sets: Sequence[TrainingSet],
    judged: Mapping[str, TrainingImages],
    card: WeightsCard,
    settings: TrainingSettings,
    *,
    initial: LoadedWeights | None = None,
    out: Path,
) -> None:
    """Run the schedule, writing weights at intervals and at the end.

    Args:
        training_sets: Training images; a batch contains sensors with equally many rows.
        judged: Held-out images to score, by name.
        card: Sidecar of the weights; the scores are added.
        settings: The schedule.
        initial: Weights to continue from; None for random ones.
        out: The `.safetensors` file.
    """
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng(settings.seed)
    net = card.build()
    for module in net.modules():
        if isinstance(module, torch.nn.Dropout2d):
            module.p = settings.dropout
        if isinstance(module, torch.nn.BatchNorm2d):
            module.momentum = _NORM_MOMENTUM
    net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # missing in the stub
    if initial is not None:
        net.load_state_dict(warm_start_parameters(initial, card))
    weights = class_weights(_drawn_labels(training_sets, card), balance=settings.balance)
    optimiser = torch.optim.AdamW(
        net.parameters(), lr=settings.peak_rate, weight_decay=settings.weight_decay
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, max_lr=settings.peak_rate, total_steps=settings.steps, pct_start=0.15
    )
    columns = (TextColumn("{task.description}"), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(card.network, total=settings.steps)
        for step in range(1, settings.steps + 1):
            net.train()
            if step > settings.steps * (1 - settings.fixed_norms):
                _fix_norms(net)
            x, y = _batch(training_sets, card, settings, rng)
            with torch.autocast("cpu", torch.bfloat16, enabled=settings.bfloat16):
                logits = net.forward_logits(x)
            loss = segmentation_loss(logits.float(), y, weights, lovasz_every=settings.lovasz_every)
            optimiser.zero_grad()
            torch.autograd.backward(loss)
            optimiser.step()
            schedule.step()
            bar.update(task, advance=1)
            if step % 50 == 0:
                log.info("%s step %d loss %.3f", card.network, step, float(loss.detach()))
            if step % _SCORED_EVERY == 0 or step == settings.steps:
                scores = _scores(net, judged, card)
                log.info("%s step %d %s", card.network, step, scores)
                save_weights(out, net, card.model_copy(update={"scores": scores}))


def _fix_norms(net: SalsaNext) -> None:
    for module in net.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.eval()


def _scores(
    net: SalsaNext, judged: Mapping[str, TrainingImages], card: WeightsCard
) -> dict[str, float]:
    return {
        f"{name} {what}": score
        for name, images in judged.items()
        for what, score in score_images(net, images, card).items()
    }


def _labels(images: TrainingImages, card: WeightsCard) -> NDArray[np.uint8]:
    return images.semantic if card.network == "salsanext" else images.motion


def _drawn_labels(training_sets: Sequence[TrainingSet], card: WeightsCard) -> NDArray[np.float64]:
    """Return the frequency of each class in the drawn images, as shares of labelled pixels."""
    drawn = np.zeros(len(card.classes))
    for training_set in training_sets:
        counts = np.bincount(_labels(training_set.images, card).ravel(), minlength=len(drawn))
        counts[IGNORED] = 0
        drawn += training_set.weight * counts / max(counts.sum(), 1)
    return drawn


def _batch(
    training_sets: Sequence[TrainingSet],
    card: WeightsCard,
    settings: TrainingSettings,
    rng: np.random.Generator,
) -> tuple[Tensor, Tensor]:
    """Draw windows of several sensors with equally many rows."""
    inputs, targets = [], []
    drawable = list(training_sets)
    for _ in range(settings.batch):
        weights = np.array([training_set.weight for training_set in drawable])
        images = drawable[int(rng.choice(len(drawable), p=weights / weights.sum()))].images
        rows = images.channels.shape[2]
        drawable = [each for each in training_sets if each.images.channels.shape[2] == rows]
        drives = images.ego_speed_m_per_s > DRIVING_M_PER_S
        share = np.where(drives, settings.driving_weight, 1.0)
        labels = _labels(images, card)
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
        changed = augment(sample, rng, columns=settings.columns)
        inputs.append(network_input(changed, card.profile, card.channels))
        targets.append(changed.labels.astype(np.int64))
    x = torch.from_numpy(np.stack(inputs)).contiguous(memory_format=torch.channels_last)
    return x, torch.from_numpy(np.stack(targets))
