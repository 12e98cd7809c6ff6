"""Training of DeLORA on pairs of scans without truth: by its published losses, or added motion."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.utils import clip_grad_norm_

from workers.lab.datasets.frame_files import Pair
from workers.lab.datasets.normal_scans import NormalScan
from workers.lab.training.kept_weights import train_kept
from workers.lab.training.known_motion import (
    begin_at_rest,
    drawn_motion,
    known_motion_loss,
    motion_errors,
)
from workers.lab.training.loop import Schedule, rising_and_falling
from workers.lab.training.odometry_loss import Surface, alignment_loss, identity_loss
from workers.lab.training.run_state import Progress
from workers.lab.training.settings import TrainingSettings
from workers.lidar.range_image import SensorProfile
from workers.paper.delora import Motion
from workers.paper.delora_odometry import image_of
from workers.paper.weights import DeLORACard
from workers.points.se3 import transform

PEAK_RATE: Final = 1e-4
"""Highest learning rate, unless it is named."""

REFINEMENTS: Final = 3
"""Estimates of a motion in use, each of what the last left, unless published."""

PUBLISHED_RATE: Final = 1e-5
PUBLISHED_EPOCHS: Final = 100
"""Learning rate as published, and its epochs; the publication states no number of epochs."""

PUBLISHED_FOV_DEG: Final = (2.0, -24.5)
PUBLISHED_SIZE: Final = (64, 720)
"""Edges of the field of view, and rows and columns of the network's image; published."""

MOST_JUDGED: Final = 16
"""Held-out pairs scored at most."""

_LARGEST_STEP: Final = 1.0
"""Largest norm of all gradients together, unless published: one pair does not undo others."""

_JUDGED_SEED: Final = 7
"""Seed of the motions added to held-out pairs, the same in each scoring."""


def published_settings(settings: TrainingSettings, *, pairs: int, epochs: int) -> TrainingSettings:
    """Return the published schedule of DeLORA for a number of pairs."""
    return replace(
        settings,
        steps=epochs * max(pairs, 1),
        epoch=max(pairs, 1),
        batch=1,
        peak_rate=PUBLISHED_RATE,
        weight_decay=0.0,
        published=True,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One scan as network and loss see it.

    Attributes:
        image: (4, H, W) float32 input of the network.
        surface: Points with normals.
    """

    image: NDArray[np.float32]
    surface: Surface


Images = tuple[NDArray[np.float32], NDArray[np.float32]]
"""(4, H, W) inputs of the network of both scans."""


class OdometryLearner:
    """DeLORA with its pairs of scans.

    Args:
        pairs: Pairs to learn from.
        judged: Held-out pairs, by log.
        card: Card of the network.
        settings: The schedule.
        initial: Parameters to continue from; None: random ones. By the published schedule these
            first fit the identity, otherwise they begin near it.
    """

    name = "delora"

    def __init__(
        self,
        pairs: Sequence[Pair],
        judged: Mapping[str, Sequence[Pair]],
        card: DeLORACard,
        settings: TrainingSettings,
        initial: Mapping[str, Tensor] | None = None,
    ) -> None:
        self._pairs, self._judged, self._settings = pairs, judged, settings
        self._profile = profile_of(card)
        self._identity = 0
        self._fits_identity = False
        self.net = card.build()
        if initial is not None:
            self.net.load_state_dict(initial)
        elif settings.published:
            self._identity = settings.epoch
        else:
            begin_at_rest(self.net)
        self.net.to(settings.device)

    def start_step(self, step: int) -> None:
        """Fit the identity in the first epoch from random weights, as published."""
        self._fits_identity = step <= self._identity

    def loss(self, rng: np.random.Generator) -> Tensor:
        """Draw pairs and compute the published losses, or that of an added motion."""
        number = self._settings.batch
        pairs = [self._pairs[int(rng.integers(len(self._pairs)))] for _ in range(number)]
        if self._settings.published:
            return self._published_loss([self._scans(each) for each in pairs])
        compared = [
            _either_way(*self._compared(*self._read(each), drawn_motion(rng)), rng=rng)
            for each in pairs
        ]
        images, expected = zip(*compared, strict=True)
        return known_motion_loss(self._motion(images), self._stacked(expected)).mean()

    def scores(self) -> tuple[float, dict[str, float]]:
        """Return the negative mean loss of held-out pairs, and by log; with that of no motion.

        Unless published, the figures are those of motions added to the pairs, and the errors of one
        estimate in metres and degrees.
        """
        scores: dict[str, float] = {}
        losses: list[float] = []
        judge = self._published_scores if self._settings.published else self._added_scores
        for name, pairs in self._judged.items():
            with torch.inference_mode():
                found = judge(pairs)
            scores |= {f"{name} {what}": value for what, value in found.items()}
            losses.append(found["loss"])
        return (-float(np.mean(losses)) if losses else float("nan")), scores

    def _published_loss(self, pairs: Sequence[tuple[Scan, Scan]]) -> Tensor:
        motion = self._motion([(this.image, following.image) for this, following in pairs])
        if self._fits_identity:
            return identity_loss(motion.this_from_next)
        losses = [
            alignment_loss(this.surface, following.surface, this_from_next).total
            for (this, following), this_from_next in zip(pairs, motion.this_from_next, strict=True)
        ]
        return torch.stack(losses).mean()

    def _published_scores(self, pairs: Sequence[Pair]) -> dict[str, float]:
        """Return the mean published loss of pairs as measured, and that of no motion."""
        still, found = torch.eye(4, device=self._settings.device), []
        for pair in pairs:
            this, following = self._scans(pair)
            motion = self._motion([(this.image, following.image)]).this_from_next[0]
            found.append(
                [
                    float(alignment_loss(this.surface, following.surface, each).total)
                    for each in (motion, still)
                ]
            )
        loss, without = np.mean(found, axis=0).tolist()
        return {"loss": loss, "loss of no motion": without}

    def _added_scores(self, pairs: Sequence[Pair]) -> dict[str, float]:
        """Return the mean loss of motions added to pairs, that of none, and the mean errors."""
        rng, found = np.random.default_rng(_JUDGED_SEED), []
        for pair in pairs:
            images, back = self._compared(*self._read(pair), drawn_motion(rng))
            expected = self._stacked([back])
            motion = self._motion([images])
            still = replace(motion, this_from_next=torch.eye(4).to(expected)[None])
            shift, turn = motion_errors(motion.this_from_next, expected)
            found.append(
                [
                    float(known_motion_loss(motion, expected)),
                    float(known_motion_loss(still, expected)),
                    float(shift.norm()),
                    float(torch.rad2deg(turn.norm())),
                ]
            )
        names = ("loss", "loss of no motion", "error m", "error deg")
        return dict(zip(names, np.mean(found, axis=0).tolist(), strict=True))

    def _read(self, pair: Pair) -> tuple[NormalScan, NormalScan]:
        return NormalScan.read(pair.first), NormalScan.read(pair.second)

    def _scans(self, pair: Pair) -> tuple[Scan, Scan]:
        first, second = self._read(pair)
        return self._seen(first), self._seen(second)

    def _compared(
        self, first: NormalScan, second: NormalScan, further: NDArray[np.float64]
    ) -> tuple[Images, NDArray[np.float64]]:
        """Return both images, the second moved by its pose and further, and the motion back."""
        guess = np.linalg.inv(first.odom_from_sensor) @ second.odom_from_sensor
        there = transform(further @ guess, second.points_m)
        images = image_of(first.points_m, self._profile)[0], image_of(there, self._profile)[0]
        back = np.asarray(np.linalg.inv(further), np.float64)
        return images, back

    def _stacked(self, motions: Sequence[NDArray[np.float64]]) -> Tensor:
        return torch.from_numpy(np.stack(motions).astype(np.float32)).to(self._settings.device)

    def _seen(self, scan: NormalScan) -> Scan:
        image, index = image_of(scan.points_m, self._profile)
        shown = index[index >= 0]
        shown = shown[scan.normals[shown].any(axis=1)]
        surface = Surface(
            torch.from_numpy(scan.points_m[shown]), torch.from_numpy(scan.normals[shown])
        )
        return Scan(image, self._on(surface))

    def _on(self, surface: Surface) -> Surface:
        device = self._settings.device
        return Surface(surface.points_m.to(device), surface.normals.to(device))

    def _motion(self, pairs: Sequence[Images]) -> Motion:
        first, second = (
            torch.from_numpy(np.stack(images)).to(self._settings.device)
            for images in zip(*pairs, strict=True)
        )
        settings = self._settings
        halved = settings.bfloat16 and self.net.training
        with torch.autocast(settings.device, torch.bfloat16, enabled=halved):
            features = self.net.resnet(torch.cat((first, second), dim=1))
        motion: Motion = self.net.motion_of(features.float())
        return motion


def _either_way(
    images: Images, expected: NDArray[np.float64], *, rng: np.random.Generator
) -> tuple[Images, NDArray[np.float64]]:
    """Exchange the images of every other pair: in use a motion is estimated both ways."""
    if rng.random() < 0.5:
        return images, expected
    return (images[1], images[0]), np.asarray(np.linalg.inv(expected), np.float64)


def profile_of(card: DeLORACard) -> SensorProfile:
    """Return the layout of the network's image."""
    return SensorProfile(
        name="delora",
        rows=card.rows,
        columns=card.columns,
        fov_up_deg=card.fov_up_deg,
        fov_down_deg=card.fov_down_deg,
    )


def train_odometry(
    pairs: Sequence[Pair],
    judged: Mapping[str, Sequence[Pair]],
    card: DeLORACard,
    settings: TrainingSettings,
    *,
    out: Path,
    initial: Mapping[str, Tensor] | None = None,
    state: Path | None = None,
    on_step: Callable[[int], None] = lambda step: None,
) -> Progress:
    """Run the schedule, writing weights after each scoring that is the best so far.

    Adam at a constant rate as published; otherwise the rate rises and falls once, and the norm of
    the gradient is bounded.

    Args:
        pairs: Pairs to learn from.
        judged: Held-out pairs, by log.
        card: Card of the weights; scores and curve are added.
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
    learner = OdometryLearner(pairs, judged, card, settings, initial)
    optimiser = torch.optim.Adam(learner.net.parameters(), lr=settings.peak_rate)
    rates: torch.optim.lr_scheduler.LRScheduler
    if settings.published:
        rates = torch.optim.lr_scheduler.ConstantLR(optimiser, factor=1.0)
    else:
        optimiser.register_step_pre_hook(lambda *_: _bound_gradients(learner.net))
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


def _bound_gradients(net: torch.nn.Module) -> None:
    clip_grad_norm_(net.parameters(), _LARGEST_STEP)
