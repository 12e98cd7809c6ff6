"""Training of SalsaNext and LMNet on training images."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from workers.lab.training.batches import Batch, TrainingSet, draw_batch, drawn_labels
from workers.lab.training.loop import Schedule, curve_text, rising_and_falling, run
from workers.lab.training.loss import class_weights, segmentation_loss
from workers.lab.training.run_state import Progress
from workers.lab.training.scores import score_images
from workers.lab.training.settings import TrainingSettings
from workers.lab.training.warm_start import warm_start_parameters
from workers.supervised.salsanext import SalsaNext
from workers.supervised.weights import LoadedWeights, WeightsCard, save_weights

_NEVER = -30.0
"""Logit of the ignored class among two groups: its probability is zero in float32."""

_KEPT_WEIGHT = 1.0
"""Weight of the loss that keeps what the initial network answers where nothing is proved."""

DECIDING = {"lmnet": "moving", "salsanext": "movable"}
"""Score of the held-out images that decides which weights are kept."""


class SegmentationLearner:
    """SalsaNext or LMNet with its training images.

    A window whose labels were proved by the self-supervised stream teaches SalsaNext which classes
    can move together, and elsewhere to answer as before (Li, Hoiem, "Learning without Forgetting",
    ECCV 2016). Everything else is learnt as published.

    Args:
        training_sets: Training images; a batch contains sensors with equally many rows.
        judged: Held-out images to score, by name.
        card: Card of the network.
        settings: The schedule.
        initial: Weights to continue from; None for random ones.
    """

    def __init__(
        self,
        training_sets: Sequence[TrainingSet],
        judged: Mapping[str, TrainingSet],
        card: WeightsCard,
        settings: TrainingSettings,
        initial: LoadedWeights | None = None,
    ) -> None:
        self._card, self._settings = card, settings
        self._sets, self._judged = training_sets, judged
        self.net: SalsaNext = card.build()
        for module in self.net.modules():
            if isinstance(module, torch.nn.Dropout2d):
                module.p = settings.dropout
            if isinstance(module, torch.nn.BatchNorm2d):
                module.momentum = settings.norm_momentum
        if initial is not None:
            self.net.load_state_dict(warm_start_parameters(initial, card))
        self.net.to(settings.device, memory_format=torch.channels_last)  # type: ignore[call-overload]  # missing in the stub
        self._movable = torch.tensor([meaning.movable for meaning in card.classes])
        told = [each for each in training_sets if not self._is_grouped(each)]
        self._weights = _weights_of(told, card, settings, len(card.classes))
        grouped = [each for each in training_sets if self._is_grouped(each)]
        self._group_weights = _weights_of(grouped, card, settings, 3)
        self._before: SalsaNext | None = None
        if grouped and initial is not None:
            self._before = card.build()
            self._before.load_state_dict(warm_start_parameters(initial, card))
            self._before.to(settings.device, memory_format=torch.channels_last).eval()  # type: ignore[call-overload]  # missing in the stub

    @property
    def name(self) -> str:
        """Name of the network."""
        return self._card.network

    def _is_grouped(self, training_set: TrainingSet) -> bool:
        return training_set.proved and self._card.network == "salsanext"

    def start_step(self, step: int) -> None:
        """Fix the batch norms in the last share of the steps."""
        if step > self._settings.steps * (1 - self._settings.fixed_norms):
            for module in self.net.modules():
                if isinstance(module, torch.nn.BatchNorm2d):
                    module.eval()

    def loss(self, rng: np.random.Generator) -> Tensor:
        """Draw a batch and compute its loss."""
        settings = self._settings
        batch = draw_batch(self._sets, self._card, settings, rng).to(settings.device)
        with torch.autocast(settings.device, torch.bfloat16, enabled=settings.bfloat16):
            logits = self.net.forward_logits(batch.inputs)
        logits = logits.float()
        if self._card.network != "salsanext" or not batch.proved.any():
            return segmentation_loss(
                logits, batch.labels, self._weights, lovasz_every=settings.lovasz_every
            )
        loss = self._proved_loss(logits, batch)
        told = ~batch.proved
        if told.any():
            loss = loss + segmentation_loss(
                logits[told], batch.labels[told], self._weights, lovasz_every=settings.lovasz_every
            )
        return loss

    def _proved_loss(self, logits: Tensor, batch: Batch) -> Tensor:
        """Return the loss of windows in which only what can move is known, and only in places."""
        proved = batch.proved
        logits, labels = logits[proved], batch.labels[proved]
        movable = self._movable.to(logits.device)
        still = ~movable
        still[0] = False
        groups = torch.stack(
            (
                torch.full_like(logits[:, 0], _NEVER),
                logits[:, still].logsumexp(1),
                logits[:, movable].logsumexp(1),
            ),
            dim=1,
        )
        loss = segmentation_loss(
            groups, labels, self._group_weights, lovasz_every=self._settings.lovasz_every
        )
        if self._before is None:
            return loss
        with torch.inference_mode():
            before = self._before.forward_logits(batch.inputs[proved])
        kept = functional.kl_div(
            functional.log_softmax(logits, dim=1),
            functional.log_softmax(before.clone(), dim=1),
            log_target=True,
            reduction="none",
        ).sum(1)
        open_pixels = (labels == 0) & (batch.inputs[proved] != 0).any(dim=1)
        return loss + _KEPT_WEIGHT * (kept * open_pixels).sum() / open_pixels.sum().clamp(min=1)

    def scores(self) -> tuple[float, dict[str, float]]:
        """Score the held-out images; NaN decides where there are none."""
        scores: dict[str, float] = {}
        deciding = []
        for name, held_out in self._judged.items():
            found = score_images(
                self.net,
                held_out.images,
                self._card,
                proved=held_out.proved,
                device=self._settings.device,
            )
            scores |= {f"{name} {what}": score for what, score in found.items()}
            wanted = DECIDING[self._card.network]
            if not found:
                continue  # no pixel of it has a label
            deciding.append(found[wanted] if wanted in found else float(np.mean([*found.values()])))
        return (float(np.mean(deciding)) if deciding else float("nan")), scores


def _weights_of(
    training_sets: Sequence[TrainingSet],
    card: WeightsCard,
    settings: TrainingSettings,
    classes: int,
) -> Tensor:
    if not training_sets:
        return torch.zeros(classes, device=settings.device)
    drawn = drawn_labels(training_sets, card, classes)
    return class_weights(drawn, balance=settings.balance).to(settings.device)


def train(
    training_sets: Sequence[TrainingSet],
    judged: Mapping[str, TrainingSet],
    card: WeightsCard,
    settings: TrainingSettings,
    *,
    out: Path,
    initial: LoadedWeights | None = None,
    state: Path | None = None,
    on_step: Callable[[int], None] = lambda step: None,
) -> Progress:
    """Run the schedule, writing weights after each scoring that is the best so far.

    Args:
        training_sets: Training images; a batch contains sensors with equally many rows.
        judged: Held-out images to score, by name.
        card: Card of the weights; scores and curve are added.
        settings: The schedule.
        out: The `.safetensors` file.
        initial: Weights to continue from; None for random ones.
        state: File to go on from after a kill; None: none.
        on_step: Called with the number of steps done.

    Returns:
        Progress at the end; `out` has its kept parameters.

    Raises:
        TrainingDivergedError: If a loss is not finite; `out` has the last good weights.
        WeightsUnusableError: If initial weights do not fit, or `out` cannot be written.
    """
    torch.set_num_threads(settings.threads)
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng(settings.seed)
    learner = SegmentationLearner(training_sets, judged, card, settings, initial)

    def keep(done: Progress) -> None:
        facts = {"curve": curve_text(done), "step": done.best_step}
        _save(out, done, card.model_copy(update={"training": {**card.training, **facts}}))

    done = run(
        learner,
        _schedule(learner.net, settings),
        rng=rng,
        state=state,
        keep=keep,
        on_step=on_step,
    )
    keep(done)
    return done


def _save(out: Path, done: Progress, card: WeightsCard) -> None:
    net = card.build()
    net.load_state_dict(done.kept)
    save_weights(out, net, card.model_copy(update={"scores": done.scores}))


def _schedule(net: SalsaNext, settings: TrainingSettings) -> Schedule:
    if settings.published:
        optimiser: torch.optim.Optimizer = torch.optim.SGD(
            net.parameters(),
            lr=settings.peak_rate,
            momentum=0.9,
            weight_decay=settings.weight_decay,
        )
        rates: torch.optim.lr_scheduler.LRScheduler = torch.optim.lr_scheduler.LambdaLR(
            optimiser, lambda step: published_rate(step, epoch=settings.epoch)
        )
    else:
        optimiser = torch.optim.AdamW(
            net.parameters(), lr=settings.peak_rate, weight_decay=settings.weight_decay
        )
        rates = rising_and_falling(optimiser, peak_rate=settings.peak_rate, steps=settings.steps)
    return Schedule(optimiser, rates, settings.steps, settings.scorings, settings.patience)


def published_rate(step: int, *, epoch: int) -> float:
    """Return the learning rate of a step as a share of the highest: warm-up, then decay."""
    if step < epoch:
        return (step + 1) / epoch
    return float(0.99 ** ((step - epoch) / epoch))
