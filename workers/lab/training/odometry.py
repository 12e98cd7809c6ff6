"""Training of DeLORA on pairs of scans, by its published losses: no truth is needed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor

from workers.lab.datasets.frame_files import Pair
from workers.lab.datasets.normal_scans import NormalScan
from workers.lab.training.kept_weights import train_kept
from workers.lab.training.loop import Schedule
from workers.lab.training.odometry_loss import Surface, alignment_loss, identity_loss
from workers.lab.training.run_state import Progress
from workers.lab.training.settings import TrainingSettings
from workers.lidar.range_image import SensorProfile
from workers.paper.delora import Motion
from workers.paper.delora_odometry import image_of
from workers.paper.weights import DeLORACard

PEAK_RATE: Final = 1e-4
"""Highest learning rate, unless it is named."""

PUBLISHED_RATE: Final = 1e-5
PUBLISHED_EPOCHS: Final = 100
"""Learning rate as published, and its epochs; the publication states no number of epochs."""

PUBLISHED_FOV_DEG: Final = (2.0, -24.5)
PUBLISHED_SIZE: Final = (64, 720)
"""Edges of the field of view, and rows and columns of the network's image; published."""

MOST_JUDGED: Final = 16
"""Held-out pairs scored at most."""

FARTHER_M: Final = 1.5
TURN_DEG: Final = 3.0
"""Largest further motion of the second scan along x, and its largest turn, unless published."""

_ASIDE: Final = 0.1
"""Largest further motion along y and z, as a share of that along x: a car drives ahead."""

_LEARNT_POINTS: Final = 4096
"""Points of the second scan that look for a partner in a step."""

_IDENTITY_SHARE: Final = 0.05
"""Share of the steps that fit the identity, in place of the published first epoch."""

_CALM: Final = 0.05
"""Factor on the first kernel's random weights unless published: its inputs are metres, and a tanh
of tens of metres has no gradient."""


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


def moved(scan: NormalScan, further: NDArray[np.float64]) -> NormalScan:
    """Return a scan as it looks from a sensor that moved farther; what it hid is missing.

    Args:
        scan: The scan.
        further: (4, 4) maps its points into the space of the moved sensor.
    """
    turn = further[:3, :3].astype(np.float32)
    return NormalScan(
        scan.points_m @ turn.T + further[:3, 3].astype(np.float32),
        scan.normals @ turn.T,
        scan.fov_deg,
    )


def drawn_motion(rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw the further motion of a car within a frame: ahead or back, hardly aside, some turn."""
    further = np.eye(4)
    angles = rng.uniform(-TURN_DEG, TURN_DEG, 3) * (1.0, _ASIDE, _ASIDE)
    further[:3, :3] = Rotation.from_euler("zyx", angles, degrees=True).as_matrix()
    further[:3, 3] = rng.uniform(-FARTHER_M, FARTHER_M, 3) * (1.0, _ASIDE, _ASIDE)
    return further


class OdometryLearner:
    """DeLORA with its pairs of scans.

    Args:
        pairs: Pairs to learn from.
        judged: Held-out pairs, by log.
        card: Card of the network.
        settings: The schedule.
        initial: Parameters to continue from; None: random ones, which first fit the identity.
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
        else:
            share = round(_IDENTITY_SHARE * settings.steps)
            self._identity = settings.epoch if settings.published else share
            if not settings.published:
                with torch.no_grad():
                    self.net.resnet.conv1.weight.mul_(_CALM)
        self.net.to(settings.device)

    def start_step(self, step: int) -> None:
        """Fit the identity in the first steps from random weights, as published."""
        self._fits_identity = step <= self._identity

    def loss(self, rng: np.random.Generator) -> Tensor:
        """Draw pairs and compute the published losses."""
        pairs = []
        for _ in range(self._settings.batch):
            pair = self._pairs[int(rng.integers(len(self._pairs)))]
            first, second = NormalScan.read(pair.first), NormalScan.read(pair.second)
            if not self._settings.published:
                second = moved(second, drawn_motion(rng))
            pairs.append((self._seen(first), self._seen(second)))
        motion = self._motion(pairs)
        if self._fits_identity:
            return identity_loss(motion.this_from_next)
        losses = []
        for (this, following), this_from_next in zip(pairs, motion.this_from_next, strict=True):
            chosen = following.surface
            if not self._settings.published:
                number = min(_LEARNT_POINTS, len(chosen.points_m))
                index = torch.from_numpy(rng.choice(len(chosen.points_m), number, replace=False))
                chosen = Surface(chosen.points_m[index], chosen.normals[index])
            losses.append(alignment_loss(this.surface, self._on(chosen), this_from_next).total)
        return torch.stack(losses).mean()

    def scores(self) -> tuple[float, dict[str, float]]:
        """Return the negative mean loss of held-out pairs; and by log, with that of no motion."""
        scores: dict[str, float] = {}
        losses: list[float] = []
        still = torch.eye(4, device=self._settings.device)
        for name, pairs in self._judged.items():
            found = []
            for pair in pairs:
                this = self._seen(NormalScan.read(pair.first))
                following = self._seen(NormalScan.read(pair.second))
                with torch.inference_mode():
                    motion = self._motion([(this, following)]).this_from_next[0]
                    found.append(
                        [
                            float(alignment_loss(this.surface, following.surface, each).total)
                            for each in (motion, still)
                        ]
                    )
            loss, without = np.mean(found, axis=0).tolist()
            scores |= {f"{name} loss": loss, f"{name} loss of no motion": without}
            losses.append(loss)
        return (-float(np.mean(losses)) if losses else float("nan")), scores

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

    def _motion(self, pairs: Sequence[tuple[Scan, Scan]]) -> Motion:
        images = [
            torch.from_numpy(np.stack([each.image for each in scans])).to(self._settings.device)
            for scans in zip(*pairs, strict=True)
        ]
        motion: Motion = self.net(*images)
        return motion


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

    Adam at a constant rate as published; otherwise the rate rises and falls once.

    Args:
        pairs: Pairs to learn from.
        judged: Held-out pairs, by log.
        card: Card of the weights; scores and curve are added.
        settings: The schedule.
        out: The `.safetensors` file.
        initial: Parameters to continue from; None: random ones, which first fit the identity.
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
        rates = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, max_lr=settings.peak_rate, total_steps=settings.steps, pct_start=0.15
        )
    return train_kept(
        learner,
        Schedule(optimiser, rates, settings.steps, settings.scorings, settings.patience),
        card,
        seed=settings.seed,
        out=out,
        state=state,
        on_step=on_step,
    )
