"""The model of the loop: a compact LMNet, taught on streets, taught on with scenes, and judged."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import rmtree
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from workers.checkpoints.devices import Device
from workers.lab.datasets.classes import meanings
from workers.lab.datasets.images import TrainingImages, build_images
from workers.lab.datasets.learnt_images import LearntImages, read_once, write_learnt
from workers.lab.datasets.simulated import clouds_of
from workers.lab.loop.streets import (
    HELD_OUT,
    TAUGHT,
    UNKNOWN,
    World,
    draw_street,
    loop_lidar,
)
from workers.lab.simulation.output.samples import StreetSample
from workers.lab.simulation.sensor.lidar import sweep
from workers.lab.training.augment import Sample, network_input
from workers.lab.training.batches import TrainingSet
from workers.lab.training.data import measured_profile
from workers.lab.training.segmentation import train
from workers.lab.training.settings import TrainingSettings
from workers.lab.training.teach import WITHOUT_INTENSITY
from workers.lidar.range_image import SensorProfile
from workers.supervised.lmnet import MOVING
from workers.supervised.residual_image import ResidualSettings
from workers.supervised.weights import LoadedWeights, WeightsCard, load_weights

PROFILE: Final = SensorProfile(
    name="lidar of the loop", rows=32, columns=384, fov_up_deg=11.0, fov_down_deg=-31.0
)
RESIDUAL: Final = ResidualSettings(ages_s=(0.1, 0.3, 0.6), min_range_m=2.0, max_range_m=100.0)

WIDTH: Final = 4
"""Channels of the first stage: the smallest network, so that many are trained in an hour."""

PAST: Final = 6
"""Frames before the first image, so that every residual has its past."""

EVERY: Final = 2
"""Interval of the frames of a stretch that become images; neighbours show almost the same."""

BATCH: Final = 8
"""Windows of a step: so small a network takes hardly longer for eight than for two."""

PEAK_RATE: Final = 6e-3
"""Highest learning rate of the first model."""

PEAK_RATE_ON: Final = 2e-3
"""Highest learning rate when a model is taught on: the first one's makes it forget."""

_BEGINS_S: Final = 2.0
_STATIC, _DYNAMIC = 1, 2


class StreetCount(BaseModel):
    """Pixels of one held-out street by their score: counts of equal steps, the lowest first.

    The score is the log-odds that the pixel moves, in steps between `LOWEST` and `HIGHEST`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    unknown: bool = Field(description="Whether the unknown road users may be on it.")
    rain: bool
    known_moving: tuple[int, ...] = Field(description="Moving pixels of known classes.")
    unknown_moving: tuple[int, ...] = Field(description="Moving pixels of the unknown classes.")
    static: tuple[int, ...] = Field(description="Static pixels.")


STEPS: Final = 80
LOWEST: Final = -10.0
HIGHEST: Final = 10.0


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Images of one held-out street, with the simulated class of each pixel as `semantic`."""

    images: TrainingImages
    unknown: bool
    rain: bool


def taught_street(folder: Path, number: int, *, seed: int) -> list[LearntImages]:
    """Build the images of a street that the first model is taught on, or read those kept."""
    return _street_images(folder, TAUGHT, number, seed=seed)


def held_out_street(folder: Path, number: int, *, seed: int) -> HeldOut:
    """Build the images of a street that judges, or read those kept."""
    [made] = _street_images(folder, HELD_OUT, number, seed=seed)
    return HeldOut(made.images, made.source[0] == "1", made.source[1] == "1")


def _street_images(folder: Path, world: World, number: int, *, seed: int) -> list[LearntImages]:
    def build(aside: Path) -> None:
        lidar = loop_lidar()
        first = round(_BEGINS_S / lidar.period_s)
        drawn = draw_street(world, number, seed=seed, seconds=2 * _BEGINS_S)
        frames = tuple(sweep(drawn.street, lidar, first + k) for k in range(2 * PAST + 1))
        clouds = [
            replace(cloud, semantic=frame.class_id)
            for cloud, frame in zip(
                clouds_of(StreetSample(drawn.street, lidar, frames)), frames, strict=False
            )
        ]
        rng = np.random.default_rng([seed, number])
        only = range(PAST, 2 * PAST, EVERY)
        images = build_images(clouds, PROFILE, RESIDUAL, variants=(1,), rng=rng, only=only)
        write_learnt(
            aside / "images", images, PROFILE, f"{int(drawn.unknown)}{int(drawn.rain)} street"
        )

    return read_once(folder / f"{number:03d}", build)


def teach(
    taught: Sequence[LearntImages],
    labelled: Sequence[LearntImages],
    *,
    steps: int,
    seed: int,
    out: Path,
    initial: LoadedWeights | None = None,
    device: Device = "cpu",
) -> LoadedWeights:
    """Teach a model on streets, and with an initial one on labelled scenes as well.

    Every image is drawn equally often, so that a few labelled ones are not learnt by heart. All
    else is the same for every choice: start, steps, rates and the streets that are replayed.

    Args:
        taught: Images of the streets of the first model.
        labelled: Images of labelled scenes.
        steps: Optimiser steps.
        seed: Seed of parameters and batches.
        out: Folder of the weights, which appears when they are complete.
        initial: Model to continue from.
        device: Device that teaches.
    """
    if not out.is_dir():
        aside = out.with_name(f".{out.name}.part")
        rmtree(aside, ignore_errors=True)
        aside.mkdir(parents=True)
        sets = sets_of([*taught, *labelled])
        card = _card(sets) if initial is None else initial.card.model_copy(update={"scores": {}})
        peak_rate = PEAK_RATE if initial is None else PEAK_RATE_ON
        train(
            sets,
            {},
            card,
            _schedule(steps, seed, peak_rate, device),
            out=aside / "lmnet.safetensors",
            initial=initial,
        )
        aside.rename(out)
    return load_model(out)


def load_model(folder: Path) -> LoadedWeights:
    """Load the model of a folder."""
    return load_weights(folder / "lmnet.safetensors")


def judge(model: LoadedWeights, held_out: Sequence[HeldOut]) -> list[StreetCount]:
    """Count the pixels of each held-out street by the score that a model gives them."""
    return [_count(each, _scores(model, each.images)) for each in held_out]


def sets_of(made: Sequence[LearntImages]) -> list[TrainingSet]:
    """Return training sets of which each image is drawn equally often, of a street or a scene."""
    return [TrainingSet(each.images, len(each), False, PROFILE) for each in made]


def _card(sets: Sequence[TrainingSet]) -> WeightsCard:
    return WeightsCard(
        network="lmnet",
        classes=meanings("lmnet"),
        width=WIDTH,
        profile=measured_profile(sets, PROFILE),
        channels=WITHOUT_INTENSITY,
        residual=RESIDUAL,
        attribution="simulated streets of Counterpoint",
        data_license="Apache-2.0",
    )


def _schedule(steps: int, seed: int, peak_rate: float, device: Device) -> TrainingSettings:
    return TrainingSettings(
        steps=steps,
        batch=BATCH,
        columns=192,
        peak_rate=peak_rate,
        fixed_norms=0.4,
        norm_momentum=0.1,
        lovasz_every=4,
        scorings=1,
        seed=seed,
        device=device,
    )


def _scores(model: LoadedWeights, images: TrainingImages) -> NDArray[np.float32]:
    """Return (F, H, W) log-odds of a model that a pixel moves."""
    found = np.zeros(images.motion.shape, np.float32)
    for number in range(len(found)):
        sample = Sample(
            images.channels[number].astype(np.float32),
            images.residuals[number, 0].astype(np.float32),
            images.seen_mask[number],
            images.motion[number],
        )
        shares = model.probabilities(network_input(sample, model.card.profile, model.card.channels))
        static, moving = np.log(np.maximum(shares[[_STATIC, MOVING]], np.float32(1e-12)))
        found[number] = moving - static
    return found


def _count(held_out: HeldOut, scores: NDArray[np.float32]) -> StreetCount:
    moves = held_out.images.motion == _DYNAMIC
    unknown = np.isin(held_out.images.semantic, UNKNOWN)
    return StreetCount(
        unknown=held_out.unknown,
        rain=held_out.rain,
        known_moving=_by_step(scores[moves & ~unknown]),
        unknown_moving=_by_step(scores[moves & unknown]),
        static=_by_step(scores[held_out.images.motion == _STATIC]),
    )


def _by_step(scores: NDArray[np.float32]) -> tuple[int, ...]:
    """Count (N,) scores by step; those outside count at the ends."""
    place = np.floor((scores - LOWEST) * (STEPS / (HIGHEST - LOWEST))).astype(np.int64)
    counts = np.bincount(np.clip(place, 0, STEPS - 1), minlength=STEPS)
    return tuple(int(count) for count in counts)
