"""Plan of the variants of real drives: the scenes in which a failure is planted, and its kind."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Final

import numpy as np

from workers.lab.evaluation.failures.planting.drive import Drive, FrameRange
from workers.lab.labels.noise_settings import REAL, NoiseSettings
from workers.lab.simulation.faults.candidates import SceneVisibility, measure_visibility
from workers.lab.simulation.faults.fault_placement import plant_in_scene
from workers.lab.simulation.faults.faults import PlantedFailure
from workers.lab.simulation.faults.plan import TEN_KINDS, FailureKind, balanced

SETTLED_S: Final = 0.7
"""Start of the time in which a failure can be found, seconds: before it, no stream has a past."""


class Answer(StrEnum):
    """Form in which the model under test answers."""

    POINTS = "points"
    BOXES = "boxes"


@dataclass(frozen=True, slots=True)
class Planting:
    """Settings of a benchmark that plants failures.

    Attributes:
        variants: Variants of each drive.
        seed: Seed of failures, noise and confidence.
        frames: Frames of each log that make its drive.
        share: Share of the scenes that get a failure.
        noise: Strength of the label noise; boxes have the errors of a detector instead.
        answer: Form of the model's answers.
    """

    variants: int = 50
    seed: int = 0
    frames: FrameRange = field(default_factory=FrameRange)
    share: float = 1 / 6
    noise: NoiseSettings = REAL
    answer: Answer = Answer.POINTS


@dataclass(frozen=True, slots=True)
class Variant:
    """One variant of a drive: its own noise, and failures in some of its scenes.

    Attributes:
        number: Number of the variant of its drive, from 0.
        seed: Seed of its noise, confidence and failures.
        frames: Frames of the log.
        noise: Strength of its noise.
        planned: Scenes that get a failure, by number, and the kind to try first.
        answer: Form of the model's answers.
    """

    number: int
    seed: int
    frames: FrameRange
    noise: NoiseSettings
    planned: tuple[tuple[int, FailureKind], ...] = ()
    answer: Answer = Answer.POINTS


def plan_variants(planting: Planting, scenes: Mapping[str, int]) -> dict[str, list[Variant]]:
    """Draw the scenes with a failure and its kind; the number of failures is exact.

    A variant gets a second failure only when all variants have one, and never two in one scene.

    Args:
        planting: Settings.
        scenes: Scenes of each drive, by log.

    Returns:
        Variants of each drive, by log.
    """
    rng = np.random.default_rng([planting.seed, 0x91A27])
    order = [
        (turn, float(rng.random()), log_id, number, scene)
        for log_id in sorted(scenes)
        for number in range(planting.variants)
        for turn, scene in enumerate(rng.permutation(scenes[log_id]).tolist())
    ]
    chosen = sorted(order)[: round(planting.share * len(order))]
    kinds = balanced(TEN_KINDS, len(chosen), rng)
    planned: dict[tuple[str, int], list[tuple[int, FailureKind]]] = {}
    for (_, _, log_id, number, scene), kind in zip(chosen, kinds, strict=True):
        planned.setdefault((log_id, number), []).append((scene, kind))
    return {
        log_id: [
            Variant(
                number,
                _seed_of(planting.seed, log_id, number),
                planting.frames,
                planting.noise,
                tuple(sorted(planned.get((log_id, number), ()))),
                planting.answer,
            )
            for number in range(planting.variants)
        ]
        for log_id in sorted(scenes)
    }


def _seed_of(seed: int, log_id: str, number: int) -> int:
    drawn = np.random.SeedSequence([seed, number, *log_id.encode()]).generate_state(1)
    return int(drawn[0])


def place_failures(drive: Drive, variant: Variant) -> list[PlantedFailure]:
    """Choose an object and a time window for each planned failure of a variant.

    A kind without a candidate in its scene is replaced by another kind of the same scene. A scene
    without any candidate gets no failure.
    """
    rng = np.random.default_rng([variant.seed, 0xBAD])
    placed = []
    for scene, kind in variant.planned:
        first, end = drive.scenes[scene]
        period_s = drive.period_s
        view = measure_visibility(
            drive,
            lambda number: drive.frames[min(number, len(drive.frames) - 1)],
            from_s=max(first * period_s, SETTLED_S),
            to_s=end * period_s,
            period_s=period_s,
        )
        others = [each for each in TEN_KINDS if each is not kind]
        order = [kind, *(others[place] for place in rng.permutation(len(others)))]
        found = (_plant(view, each, scene, rng) for each in order)
        failure = next((each for each in found if each is not None), None)
        if failure is not None:
            placed.append(failure)
    return placed


def _plant(
    view: SceneVisibility, kind: FailureKind, scene: int, rng: np.random.Generator
) -> PlantedFailure | None:
    """Plant a failure of a kind; some ghosts are in parked cars, some large movers fail in part."""
    in_car = kind is FailureKind.GHOST_MOVER and rng.random() < GHOST_IN_CAR_SHARE
    as_kind = FailureKind.PARKED_CALLED_MOVING if in_car else kind
    failure = plant_in_scene(view, as_kind, scene, rng)
    if failure is None:
        return None
    part = round(float(rng.uniform(*PART)), 2)
    if in_car:
        return replace(failure, kind=kind, part=part)
    large = failure.track >= 0 and np.median(view.points[:, failure.track]) >= LARGE_POINTS
    if large and kind in IN_PART and rng.random() < PART_SHARE:
        return replace(failure, part=part)
    return failure


GHOST_IN_CAR_SHARE: Final = 1 / 3
"""Share of ghosts that lie in a standing object of the truth, and not on structure."""

LARGE_POINTS: Final = 500
"""Median points of an object that a model may label in part."""

IN_PART: Final = (FailureKind.MISSED_MOVER, FailureKind.VERSION_REGRESSION)
PART_SHARE: Final = 0.5
PART: Final = (0.6, 0.9)
"""Least and largest part; below half of its points an object does not count as failing."""
