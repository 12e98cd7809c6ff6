"""Training of GndNet on clouds whose ground Counterpoint found: no human labelled it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, cast

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

from workers.lab.datasets.ground_clouds import GroundCloud, cell_heights, filled
from workers.lab.training.elevation_loss import elevation_loss, seen_elevation_loss
from workers.lab.training.kept_weights import train_kept
from workers.lab.training.loop import Schedule, rising_and_falling
from workers.lab.training.run_state import Progress
from workers.lab.training.settings import TrainingSettings
from workers.paper.gndnet import GRID, GndNet, PfnLayer, decorate
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

_CALM: Final = 1 / 50
"""Factor on the first layer's random weights of x and y unless published.

x and y reach 50 m, and the height of the ground a few decimetres. With equal weights a pillar's
code, the largest of its points, is its place alone, and the first steps learn no height."""


def optimiser_in_words(*, published: bool) -> str:
    """Return the optimiser in words, for the card."""
    if published:
        return "SGD, momentum 0.9, weight decay 5e-4, rate times 0.8 after each eighth"
    return "Adam, the rate rises and falls once"


def loss_in_words(*, published: bool) -> str:
    """Return the loss in words, for the card."""
    if published:
        return "smooth L1, bend at 1 m, all cells alike; smoothness"
    return "smooth L1, bend at 0.05 m, cells without ground weigh a fiftieth; smoothness"


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


def encoded(net: GndNet, sample: GroundSample, device: str) -> Tensor:
    """Encode the pillars of a cloud as the network does, without the places that have no point.

    Of a pillar's 100 places a tenth has a point. Each of the others has the bias of the layer.

    Returns:
        (M, 64) codes.
    """
    points, counts = sample.points.to(device), sample.counts.to(device)
    layer = _first_layer(net)
    filled_places = torch.arange(points.shape[1], device=device)[None] < counts[:, None]
    described = layer(decorate(points, counts, sample.cells_zyx.to(device))[filled_places])
    pillar = filled_places.nonzero()[:, 0, None].expand_as(described)
    has_room = (counts < points.shape[1])[:, None]
    start = torch.where(has_room, layer.bias, described.new_tensor(-torch.inf))
    codes: Tensor = start.scatter_reduce(0, pillar, described, "amax", include_self=True).relu()
    return codes


def elevations(
    net: GndNet, samples: Sequence[GroundSample], device: str, *, bfloat16: bool = False
) -> Tensor:
    """Estimate (B, 100, 100) heights of a batch; its clouds share the batch statistics."""
    rows, columns = GRID
    maps = []
    for each in samples:
        codes = encoded(net, each, device)
        cells = (each.cells_zyx[:, 1] * columns + each.cells_zyx[:, 2]).to(device)
        flat = codes.new_zeros(codes.shape[1], rows * columns)
        maps.append(flat.index_copy(1, cells, codes.t()).view(-1, rows, columns))
    with torch.autocast(device, torch.bfloat16, enabled=bfloat16):
        answer: Tensor = net.encoder_decoder(torch.stack(maps))[:, 0].float()
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
        elif not settings.published:
            _calm(self.net)
        if not settings.published:
            for module in self.net.modules():
                if isinstance(module, nn.BatchNorm2d):
                    module.momentum = settings.norm_momentum
        self.net.to(settings.device)

    def start_step(self, step: int) -> None:
        """Train in the same mode in every step, as published."""

    def loss(self, rng: np.random.Generator) -> Tensor:
        """Draw clouds, tilt them, and compute the loss of the preset."""
        settings = self._settings
        largest = tilt_deg(settings)
        samples = []
        for _ in range(settings.batch):
            path = self._clouds[int(rng.integers(len(self._clouds)))]
            tilt = Rotation.from_euler("xy", rng.uniform(-largest, largest, 2), degrees=True)
            samples.append(sample_of(GroundCloud.read(path), height_m=self._height_m, tilt=tilt))
        truth = torch.from_numpy(np.stack([filled(each.seen_m) for each in samples]))
        truth = truth.to(settings.device)
        found = elevations(self.net, samples, settings.device, bfloat16=settings.bfloat16)
        if settings.published:
            return elevation_loss(found, truth)
        seen = torch.from_numpy(np.stack([np.isfinite(each.seen_m) for each in samples]))
        return seen_elevation_loss(found, truth, seen.to(settings.device))

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


def _calm(net: GndNet) -> None:
    """Scale the first layer's weights of x and y to the size of its other inputs."""
    with torch.no_grad():
        _first_layer(net).weight[:, :2].mul_(_CALM)


def _first_layer(net: GndNet) -> nn.Linear:
    return cast(PfnLayer, net.voxel_feature_extractor.pfn_layers[0]).linear


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

    As published: SGD with momentum 0.9 and weight decay 5e-4, whose rate falls by 0.8 in eight
    parts. Otherwise Adam, whose rate rises and falls once.

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
    optimiser, rates = _optimiser(learner.net, settings)
    return train_kept(
        learner,
        Schedule(optimiser, rates, settings.steps, settings.scorings, settings.patience),
        card,
        seed=settings.seed,
        out=out,
        state=state,
        on_step=on_step,
    )


def _optimiser(
    net: GndNet, settings: TrainingSettings
) -> tuple[torch.optim.Optimizer, torch.optim.lr_scheduler.LRScheduler]:
    if not settings.published:
        adam = torch.optim.Adam(net.parameters(), lr=settings.peak_rate)
        return adam, rising_and_falling(adam, peak_rate=settings.peak_rate, steps=settings.steps)
    sgd = torch.optim.SGD(
        net.parameters(), lr=settings.peak_rate, momentum=_MOMENTUM, weight_decay=_WEIGHT_DECAY
    )
    falls = max(-(-settings.steps // _FALLS), 1)
    return sgd, torch.optim.lr_scheduler.StepLR(sgd, falls, gamma=_FALL)
