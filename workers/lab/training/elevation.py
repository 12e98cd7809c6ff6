"""Training of GndNet on clouds whose ground Counterpoint found: no human labelled it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor

from workers.lab.datasets.ground_clouds import GroundCloud, cell_heights, filled
from workers.lab.training.elevation_loss import elevation_loss
from workers.lab.training.kept_weights import train_kept
from workers.lab.training.loop import Schedule
from workers.lab.training.run_state import Progress
from workers.lab.training.settings import TrainingSettings
from workers.paper.gndnet import GRID, GndNet
from workers.paper.pillars import pillars
from workers.paper.weights import GndNetCard

PUBLISHED_TILT_DEG: Final = 10.0
"""Largest roll and pitch of the published augmentation, degrees."""

TILT_DEG: Final = 3.0
"""Largest roll and pitch otherwise, degrees: a slope of 5 %, and a car that nods."""

PUBLISHED_BATCH: Final = 2
PUBLISHED_EPOCHS: Final = 120
PUBLISHED_RATE: Final = 0.01
PUBLISHED_EVERY: Final = 4
"""Clouds of a step, epochs, learning rate, and the share of frames taken; published."""

_MOMENTUM: Final = 0.9
_WEIGHT_DECAY: Final = 5e-4
_FALL: Final = 0.8
_FALLS: Final = 8
"""Momentum, weight decay, and falls of the rate: by 0.8 in each of 8 parts, 15 epochs of 120."""


OPTIMISER: Final = "SGD, momentum 0.9, weight decay 5e-4, rate times 0.8 after each eighth"
"""The optimiser in words, for the card."""


def tilt_deg(settings: TrainingSettings) -> float:
    """Return the largest roll and pitch of the augmentation, degrees."""
    return PUBLISHED_TILT_DEG if settings.published else TILT_DEG


def published_settings(settings: TrainingSettings, *, clouds: int, epochs: int) -> TrainingSettings:
    """Return the published schedule of GndNet for a number of clouds (Paigwar et al., 2020)."""
    return replace(
        settings,
        steps=epochs * max(-(-clouds // PUBLISHED_BATCH), 1),
        batch=PUBLISHED_BATCH,
        peak_rate=PUBLISHED_RATE,
        weight_decay=_WEIGHT_DECAY,
        published=True,
    )


@dataclass(frozen=True, slots=True, eq=False)
class GroundSample:
    """One cloud as the network sees it, and its ground.

    Attributes:
        points: (M, P, 4) float32 pillars.
        counts: (M,) int64 points of each.
        cells_zyx: (M, 3) int64 cells.
        seen_m: (100, 100) height of the ground over the road below the sensor, NaN where unseen.
    """

    points: Tensor
    counts: Tensor
    cells_zyx: Tensor
    seen_m: NDArray[np.float32]


def sample_of(cloud: GroundCloud, *, height_m: float, tilt: Rotation | None = None) -> GroundSample:
    """Build the network's input and label of a cloud.

    Args:
        cloud: The cloud.
        height_m: Height of the sensor of the card, added to every z.
        tilt: Rotation about the road below the sensor; None: none.
    """
    raised = cloud.points_m + np.array([0.0, 0.0, height_m], np.float32)
    if tilt is not None:
        raised = tilt.apply(raised).astype(np.float32)
    made = pillars(raised, cloud.intensity, lidar_height_m=0.0)
    return GroundSample(
        torch.from_numpy(made.points),
        torch.from_numpy(made.counts.astype(np.int64)),
        torch.from_numpy(made.coordinates_zyx.astype(np.int64)),
        cell_heights(raised[cloud.ground]),
    )


def elevations(net: GndNet, samples: Sequence[GroundSample], device: str) -> Tensor:
    """Estimate (B, 100, 100) heights of a batch; its clouds share the batch statistics."""
    rows, columns = GRID
    maps = []
    for each in samples:
        encoded = net.voxel_feature_extractor(
            each.points.to(device), each.counts.to(device), each.cells_zyx.to(device)
        )
        cells = (each.cells_zyx[:, 1] * columns + each.cells_zyx[:, 2]).to(device)
        flat = encoded.new_zeros(encoded.shape[1], rows * columns)
        maps.append(flat.index_copy(1, cells, encoded.t()).view(-1, rows, columns))
    answer: Tensor = net.encoder_decoder(torch.stack(maps))[:, 0]
    return answer


class GroundLearner:
    """GndNet with its clouds.

    Args:
        clouds: Files of the clouds to learn from.
        judged: Files of held-out clouds, by log.
        card: Card of the network.
        settings: The schedule.
        initial: Parameters to continue from; None: random ones.
    """

    name = "gndnet"

    def __init__(
        self,
        clouds: Sequence[Path],
        judged: Mapping[str, Sequence[Path]],
        card: GndNetCard,
        settings: TrainingSettings,
        initial: Mapping[str, Tensor] | None = None,
    ) -> None:
        self._clouds, self._judged = clouds, judged
        self._height_m, self._settings = card.sensor_height_m, settings
        self.net = card.build()
        if initial is not None:
            self.net.load_state_dict(initial)
        self.net.to(settings.device)

    def start_step(self, step: int) -> None:
        """Train in the same mode in every step, as published."""

    def loss(self, rng: np.random.Generator) -> Tensor:
        """Draw clouds, tilt them, and compute the published loss."""
        settings = self._settings
        largest = tilt_deg(settings)
        samples = []
        for _ in range(settings.batch):
            path = self._clouds[int(rng.integers(len(self._clouds)))]
            tilt = Rotation.from_euler("xy", rng.uniform(-largest, largest, 2), degrees=True)
            samples.append(sample_of(GroundCloud.read(path), height_m=self._height_m, tilt=tilt))
        truth = torch.from_numpy(np.stack([filled(each.seen_m) for each in samples]))
        found = elevations(self.net, samples, settings.device)
        return elevation_loss(found, truth.to(settings.device))

    def scores(self) -> tuple[float, dict[str, float]]:
        """Return the negative mean error in held-out cells with ground, and the error by log."""
        scores = {}
        for name, paths in self._judged.items():
            errors = []
            for path in paths:
                sample = sample_of(GroundCloud.read(path), height_m=self._height_m)
                with torch.inference_mode():
                    found = elevations(self.net, [sample], self._settings.device)[0].cpu().numpy()
                errors.append(np.abs(found - sample.seen_m)[np.isfinite(sample.seen_m)])
            scores[f"{name} height error m"] = float(np.concatenate(errors).mean())
        return (-float(np.mean([*scores.values()])) if scores else float("nan")), scores


def train_ground(
    clouds: Sequence[Path],
    judged: Mapping[str, Sequence[Path]],
    card: GndNetCard,
    settings: TrainingSettings,
    *,
    out: Path,
    initial: Mapping[str, Tensor] | None = None,
    state: Path | None = None,
    on_step: Callable[[int], None] = lambda step: None,
) -> Progress:
    """Run the schedule, writing weights after each scoring that is the best so far.

    SGD with momentum 0.9 and weight decay 5e-4; the rate falls by 0.8 in eight parts, as published.

    Args:
        clouds: Files of the clouds to learn from.
        judged: Files of held-out clouds, by log.
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
    learner = GroundLearner(clouds, judged, card, settings, initial)
    optimiser = torch.optim.SGD(
        learner.net.parameters(),
        lr=settings.peak_rate,
        momentum=_MOMENTUM,
        weight_decay=_WEIGHT_DECAY,
    )
    rates = torch.optim.lr_scheduler.StepLR(
        optimiser, max(-(-settings.steps // _FALLS), 1), gamma=_FALL
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
