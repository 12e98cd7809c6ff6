"""Training of FlowStep3D on pairs of clouds, by its published loss: no truth is needed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from schemas.arrays import Points
from workers.lab.datasets.flow_clouds import FlowCloud
from workers.lab.datasets.frame_files import Pair
from workers.lab.training.flow_loss import FINE_TUNING, PRE_TRAINING, FlowLossSettings, flow_loss
from workers.lab.training.kept_weights import train_kept
from workers.lab.training.loop import Schedule, rising_and_falling
from workers.lab.training.run_state import Progress
from workers.lab.training.settings import TrainingSettings
from workers.paper.learned_flow import FLOW_AXES
from workers.paper.weights import FlowStep3DCard

DEFAULT_POINTS: Final = 4096
PEAK_RATE: Final = 2e-3
"""Points drawn of each cloud, and the highest learning rate, unless they are named."""

MOST_JUDGED: Final = 8
"""Held-out pairs scored at most: a pair takes as long as half a step."""

_JUDGED_SEED: Final = 11


@dataclass(frozen=True, slots=True)
class FlowRecipe:
    """Loss and augmentation of a training of FlowStep3D.

    Attributes:
        loss: Weights of the loss.
        decay: Of the network: step i of the flow is divided by decay * i + 1.
        epochs: Epochs of the published schedule.
        falls: Epochs after which the rate halves.
        yaw_deg: Largest turn of both clouds about the vertical, degrees.
        shift_m: Largest shift of both clouds along each axis, metres.
        scale: Smallest and largest scale of both clouds.
        other_shift_m: Largest further shift of the second cloud along each axis, metres.
        movers: Upright cylinders of the second cloud that are shifted, as if they had moved.
        mover_m: Their radius, and the largest shift along each horizontal axis, metres.
    """

    loss: FlowLossSettings
    decay: float
    epochs: int
    falls: tuple[int, ...]
    yaw_deg: float = 10.0
    shift_m: float = 1.0
    scale: tuple[float, float] = (0.95, 1.05)
    other_shift_m: float = 0.2
    movers: int = 0
    mover_m: tuple[float, float] = (2.5, 1.5)


PUBLISHED: Final[Mapping[str, FlowRecipe]] = {
    "published": FlowRecipe(PRE_TRAINING, decay=1.0, epochs=80, falls=(50, 70)),
    "published-finetune": FlowRecipe(FINE_TUNING, decay=0.5, epochs=30, falls=(5, 15, 25)),
}
"""Both published settings by preset: the first from random weights, the second from those."""

DEFAULT: Final = FlowRecipe(PRE_TRAINING, decay=0.5, epochs=0, falls=(), movers=6)
"""The first published loss; ego-motion is removed, so that little of a cloud moves by itself."""

PUBLISHED_POINTS: Final = 8192
PUBLISHED_BATCH: Final = 16
"""Points of each cloud, and pairs of a step (2 on each of 8 devices); published."""


def recipe_of(preset: str) -> FlowRecipe:
    """Return the recipe of a preset of training."""
    return PUBLISHED.get(preset, DEFAULT)


def published_settings(settings: TrainingSettings, *, pairs: int, epochs: int) -> TrainingSettings:
    """Return the published schedule of FlowStep3D for a number of pairs."""
    return replace(
        settings,
        steps=epochs * max(-(-pairs // PUBLISHED_BATCH), 1),
        batch=PUBLISHED_BATCH,
        peak_rate=PEAK_RATE,
        weight_decay=0.0,
        published=True,
    )


def augmented(
    first: NDArray[np.float32],
    second: NDArray[np.float32],
    recipe: FlowRecipe,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Turn, shift and scale both clouds alike, then shift the second one, and parts of it.

    Args:
        first: (N, 3) metres; x left, y up, z ahead.
        second: (M, 3) in the same space.
        recipe: How far.
        rng: What is drawn.
    """
    moved = second.copy()
    radius_m, most_m = recipe.mover_m
    for centre in rng.integers(len(second), size=recipe.movers):
        inside = np.linalg.norm((second - second[centre])[:, [0, 2]], axis=1) < radius_m
        along_x, along_z = rng.uniform(-most_m, most_m, 2).tolist()
        moved[inside] += np.array([along_x, 0, along_z], np.float32)
    turn = np.radians(rng.uniform(-recipe.yaw_deg, recipe.yaw_deg))
    sine, cosine = np.sin(turn), np.cos(turn)
    about_up = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    about_up = (about_up * rng.uniform(*recipe.scale)).astype(np.float32)
    shift = rng.uniform(-recipe.shift_m, recipe.shift_m, 3).astype(np.float32)
    further = rng.uniform(-recipe.other_shift_m, recipe.other_shift_m, 3).astype(np.float32)
    return first @ about_up.T + shift, moved @ about_up.T + shift + further


def drawn(points_m: Points, count: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw points, in the network's axes; each once, unless there are too few."""
    index = rng.choice(len(points_m), count, replace=len(points_m) < count)
    return np.ascontiguousarray(points_m[index][:, FLOW_AXES], np.float32)


class FlowLearner:
    """FlowStep3D with its pairs of clouds.

    Args:
        pairs: Pairs to learn from.
        judged: Held-out pairs, by log.
        card: Card of the network.
        recipe: Loss and augmentation.
        settings: The schedule.
        initial: Parameters to continue from; None: random ones.
    """

    name = "flowstep3d"

    def __init__(
        self,
        pairs: Sequence[Pair],
        judged: Mapping[str, Sequence[Pair]],
        card: FlowStep3DCard,
        recipe: FlowRecipe,
        settings: TrainingSettings,
        initial: Mapping[str, Tensor] | None = None,
    ) -> None:
        self._pairs, self._judged = pairs, judged
        self._points, self._recipe, self._settings = card.points, recipe, settings
        self.net = card.build()
        if initial is not None:
            self.net.load_state_dict(initial)
        self.net.to(settings.device)

    def start_step(self, step: int) -> None:
        """Train in the same mode in every step, as published."""

    def loss(self, rng: np.random.Generator) -> Tensor:
        """Draw pairs, augment them, and compute the published loss."""
        firsts, seconds = [], []
        for _ in range(self._settings.batch):
            pair = self._pairs[int(rng.integers(len(self._pairs)))]
            first, second = augmented(*self._clouds(pair, rng), self._recipe, rng)
            firsts.append(first)
            seconds.append(second)
        flows, this, following = self._flows(np.stack(firsts), np.stack(seconds))
        totals = [
            flow_loss(
                this[index], following[index], [each[index] for each in flows], self._recipe.loss
            )[0]
            for index in range(len(firsts))
        ]
        return torch.stack(totals).mean()

    def scores(self) -> tuple[float, dict[str, float]]:
        """Return the negative mean loss of held-out pairs, and by log the distances in metres."""
        scores: dict[str, float] = {}
        losses: list[float] = []
        for name, pairs in self._judged.items():
            found = []
            for number, pair in enumerate(pairs):
                rng = np.random.default_rng((_JUDGED_SEED, number))
                first, second = self._clouds(pair, rng)
                with torch.inference_mode():
                    flows, this, following = self._flows(first[None], second[None])
                    total, parts = flow_loss(
                        this[0], following[0], [each[0] for each in flows], self._recipe.loss
                    )
                found.append((float(total), float(parts[-1].chamfer)))
            loss, distance_m = np.mean(found, axis=0).tolist()
            scores |= {f"{name} loss": loss, f"{name} chamfer m": distance_m}
            losses.append(loss)
        return (-float(np.mean(losses)) if losses else float("nan")), scores

    def _clouds(
        self, pair: Pair, rng: np.random.Generator
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        first, second = FlowCloud.read(pair.first).before(FlowCloud.read(pair.second))
        return drawn(first, self._points, rng), drawn(second, self._points, rng)

    def _flows(
        self, first: NDArray[np.float32], second: NDArray[np.float32]
    ) -> tuple[list[Tensor], Tensor, Tensor]:
        this = torch.from_numpy(first).to(self._settings.device)
        following = torch.from_numpy(second).to(self._settings.device)
        return self.net(this, following, iterates=len(self._recipe.loss.iterate)), this, following


def train_flow(
    pairs: Sequence[Pair],
    judged: Mapping[str, Sequence[Pair]],
    card: FlowStep3DCard,
    recipe: FlowRecipe,
    settings: TrainingSettings,
    *,
    out: Path,
    initial: Mapping[str, Tensor] | None = None,
    state: Path | None = None,
    on_step: Callable[[int], None] = lambda step: None,
) -> Progress:
    """Run the schedule, writing weights after each scoring that is the best so far.

    Adam as published. The published rate halves after some epochs; otherwise it rises and falls
    once.

    Args:
        pairs: Pairs to learn from.
        judged: Held-out pairs, by log.
        card: Card of the weights; scores and curve are added.
        recipe: Loss and augmentation.
        settings: The schedule.
        out: The `.safetensors` file.
        initial: Parameters to continue from; None: random ones.
        state: File to go on from after a kill; None: none.
        on_step: Called with the number of steps done.

    Raises:
        TrainingDivergedError: If a loss is not finite; `out` has the last good weights.
        WeightsUnusableError: If `out` cannot be written.
    """
    torch.set_num_threads(settings.threads)
    torch.manual_seed(settings.seed)
    learner = FlowLearner(pairs, judged, card, recipe, settings, initial)
    optimiser = torch.optim.Adam(learner.net.parameters(), lr=settings.peak_rate)
    rates: torch.optim.lr_scheduler.LRScheduler
    if settings.published:
        epoch = max(-(-len(pairs) // settings.batch), 1)
        falls = [fall * epoch for fall in recipe.falls]
        rates = torch.optim.lr_scheduler.MultiStepLR(optimiser, falls, gamma=0.5)
    else:
        rates = rising_and_falling(optimiser, peak_rate=settings.peak_rate, steps=settings.steps)
    return train_kept(
        learner,
        Schedule(optimiser, rates, settings.steps, settings.scorings, settings.patience),
        card,
        seed=settings.seed,
        out=out,
        state=state,
        on_step=on_step,
    )
