"""The training loop of one network: schedule, batches, scores now and then."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from torch import Tensor

from workers.geometry.range_image import SensorProfile
from workers.supervised.lmnet import LMNet
from workers.supervised.salsanext import SalsaNext
from workers.supervised.weights import LoadedWeights, WeightsCard, save_weights
from workers.training.augment import Sample, augment, network_input
from workers.training.images import TrainingImages
from workers.training.loss import class_weights, segmentation_loss

log = logging.getLogger(__name__)

DRIVING_M_PER_S: Final = 0.5
"""From here on the car drives, and static things no longer look the same in every frame."""


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """What a training run depends on, beside its data.

    Attributes:
        model: `salsanext` or `lmnet`.
        width: Channels of the first stage.
        steps: Optimiser steps of the schedule.
        stop_after: Steps after which to stop short of the schedule's end; 0 to finish it.
        balance: Exponent of the class weights.
        batch: Windows per step.
        driving_weight: How many times more often a frame is drawn in which the car drives.
        columns: Width of a window.
        peak_rate: Highest learning rate of the one-cycle schedule.
        weight_decay: Of AdamW.
        dropout: Share of channels dropped.
        seed: Of everything random.
    """

    model: str
    width: int = 8
    steps: int = 2400
    batch: int = 2
    driving_weight: float = 4.0
    columns: int = 512
    stop_after: int = 0
    balance: float = 1.0
    peak_rate: float = 4e-3
    weight_decay: float = 1e-3
    dropout: float = 0.02
    seed: int = 1


def train(
    learn: TrainingImages,
    judge: TrainingImages,
    card: WeightsCard,
    settings: TrainingSettings,
    *,
    initial: LoadedWeights | None = None,
    out: Path,
) -> None:
    """Run the schedule, writing weights now and then and at the end.

    Args:
        learn: Images to learn from.
        judge: Images to score, never learnt from.
        card: Sidecar of the weights; the scores are added.
        settings: The schedule.
        initial: Weights to go on from; None for random ones.
        out: The `.safetensors` file.
    """
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng(settings.seed)
    classes = len(card.classes)
    net = (
        SalsaNext(classes=classes, width=settings.width, dropout=settings.dropout)
        if card.residual is None
        else LMNet(
            residuals=len(card.residual.ages_s), width=settings.width, dropout=settings.dropout
        )
    )
    net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # missing in the stub
    if initial is not None:
        net.load_state_dict(initial.net.state_dict())
    labels = learn.semantic if card.network == "salsanext" else learn.motion
    weights = class_weights(
        torch.from_numpy(labels.astype(np.int64)), classes=classes, balance=settings.balance
    )
    optimiser = torch.optim.AdamW(
        net.parameters(), lr=settings.peak_rate, weight_decay=settings.weight_decay
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, max_lr=settings.peak_rate, total_steps=settings.steps, pct_start=0.15
    )
    columns = (
        TextColumn("{task.description}"),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(card.network, total=settings.stop_after or settings.steps)
        last = settings.stop_after or settings.steps
        for step in range(1, last + 1):
            net.train()
            x, y = _batch(learn, labels, card.profile, settings, rng)
            loss = segmentation_loss(net.forward_logits(x), y, weights)
            optimiser.zero_grad()
            torch.autograd.backward(loss)
            optimiser.step()
            schedule.step()
            bar.update(task, advance=1)
            if step % 50 == 0:
                log.info("%s step %d loss %.3f", card.network, step, float(loss.detach()))
            if step % 200 == 0 or step == last:
                scores = score_images(net, judge, card)
                log.info("%s step %d %s", card.network, step, scores)
                save_weights(out, net, card.model_copy(update={"scores": scores}))


def score_images(net: SalsaNext, images: TrainingImages, card: WeightsCard) -> dict[str, float]:
    """Intersection over union of each class, over pixels that show a labelled point.

    Args:
        net: The network.
        images: What to score it on.
        card: Names of the classes and the normalisation.

    Returns:
        IoU per class present, and of all movable classes taken together for semantics.
    """
    net.eval()
    truth = images.semantic if card.network == "salsanext" else images.motion
    classes = len(card.classes)
    confusion = np.zeros((classes, classes), dtype=np.int64)
    for number in range(len(truth)):
        sample = _sample(images, truth, number, variant=0)
        x = torch.from_numpy(network_input(sample, card.profile))[None]
        with torch.inference_mode():
            found = net(x.contiguous(memory_format=torch.channels_last))[0].argmax(0).numpy()
        counted = truth[number] > 0
        np.add.at(confusion, (truth[number][counted], found[counted]), 1)
    hits = confusion.diagonal()
    union = confusion.sum(0) + confusion.sum(1) - hits
    scores = {
        meaning.name: round(float(hits[index] / union[index]), 4)
        for index, meaning in enumerate(card.classes)
        if index and confusion[index].sum()
    }
    movable = np.array([meaning.movable for meaning in card.classes])
    if movable.any():
        both = confusion[np.ix_(movable, movable)].sum()
        either = confusion[movable].sum() + confusion[:, movable].sum() - both
        scores["movable"] = round(float(both / either), 4)
    return scores


def _batch(
    images: TrainingImages,
    labels: NDArray[np.uint8],
    profile: SensorProfile,
    settings: TrainingSettings,
    rng: np.random.Generator,
) -> tuple[Tensor, Tensor]:
    inputs, targets = [], []
    share = None
    if settings.driving_weight != 1:
        drives = images.ego_speed_m_per_s > DRIVING_M_PER_S
        weight = np.where(drives, settings.driving_weight, 1.0)
        share = weight / weight.sum()
    for number in rng.choice(len(labels), size=settings.batch, replace=False, p=share):
        variant = int(rng.integers(images.residuals.shape[1]))
        sample = augment(_sample(images, labels, number, variant), rng, columns=settings.columns)
        inputs.append(network_input(sample, profile))
        targets.append(sample.labels.astype(np.int64))
    x = torch.from_numpy(np.stack(inputs)).contiguous(memory_format=torch.channels_last)
    return x, torch.from_numpy(np.stack(targets))


def _sample(images: TrainingImages, labels: NDArray[np.uint8], number: int, variant: int) -> Sample:
    return Sample(
        images.channels[number],
        images.residuals[number, variant].astype(np.float32),
        images.seen_mask[number],
        labels[number],
    )
