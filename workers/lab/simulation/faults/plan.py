"""Fleet plan: draws the scenes with a failure or a disturbance, and the hard logs.

The plan does not depend on streets. It draws what is planted where. `fault_placement.py` finds the
tracks that can carry it, once the street of the log is known.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import ceil
from typing import Final, TypeVar

import numpy as np

Kind = TypeVar("Kind")

SCENE_S: Final = 2.0
LOG_S: Final = 20.0
LIFELIKE_LOG_S: Final = (4.0, 16.0)
"""Shortest and longest log of a lifelike fleet, seconds."""

_BEGINS_S: Final = (2.0, 8.0)
"""Part of the drive that a lifelike log leaves out before its first frame, seconds."""

COMMON_MODE_SHARE: Final = 0.2
DISTURBED_SHARE: Final = 0.2
HARD_SHARE: Final = 0.4

VERSIONS: Final = ("2026.1", "2026.2")
REGRESSED_VERSION: Final = VERSIONS[1]
"""The software version with a regression in one class; every other log runs it."""


class FailureKind(StrEnum):
    """Kind of a failure of the on-board model on one object.

    MISSED_MOVER is not drawn with the others. It is the kind of common-mode failures: a mover that
    the self-supervised stream tends to miss too. HALF_LABELLED is drawn for lifelike fleets only.
    """

    UNSEEN_CLASS = "unseen_class"
    MISSED_PEDESTRIAN = "missed_pedestrian"
    GHOST_MOVER = "ghost_mover"
    PARKED_CALLED_MOVING = "parked_called_moving"
    FLICKER = "flicker"
    LATE_DETECTION = "late_detection"
    LABEL_SWAP = "label_swap"
    RANGE_LIMIT = "range_limit"
    VERSION_REGRESSION = "version_regression"
    MISSED_MOVER = "missed_mover"
    HALF_LABELLED = "half_labelled"


FAILURE_MEANS: Final[Mapping[FailureKind, str]] = {
    FailureKind.UNSEEN_CLASS: "labels a mover of a rare class static, and an object",
    FailureKind.MISSED_PEDESTRIAN: "labels a pedestrian static, and an object",
    FailureKind.GHOST_MOVER: "labels static structure a moving car",
    FailureKind.PARKED_CALLED_MOVING: "labels a parked car moving",
    FailureKind.FLICKER: "alternates on an object: 0.3 s wrong, 0.15 s right",
    FailureKind.LATE_DETECTION: "labels a mover static when it first becomes visible",
    FailureKind.LABEL_SWAP: "labels a mover static, and a standing object nearby moving",
    FailureKind.RANGE_LIMIT: "labels all movers beyond a range static",
    FailureKind.VERSION_REGRESSION: "labels movers static that the version before labelled right",
    FailureKind.MISSED_MOVER: "labels a mover static that the other stream tends to miss",
    FailureKind.HALF_LABELLED: "labels the greater part of a lorry or bus that drives static",
}
"""Effect of each kind of failure on the on-board model's labels."""

DRAWN_KINDS: Final = tuple(
    kind
    for kind in FailureKind
    if kind not in (FailureKind.MISSED_MOVER, FailureKind.HALF_LABELLED)
)
"""Kinds that are drawn with equal probability; common-mode failures are drawn apart."""

LIFELIKE_KINDS: Final = (*DRAWN_KINDS, FailureKind.HALF_LABELLED)
"""The same for lifelike fleets."""

TEN_KINDS: Final = (*DRAWN_KINDS, FailureKind.MISSED_MOVER)
"""Kinds that are planted into labels of real drives."""


class DisturbanceKind(StrEnum):
    """Kind of a disturbance of the recording that is no failure of the model."""

    ODOMETRY_SLIP = "odometry_slip"
    GROUND_LEAK = "ground_leak"
    SENSOR_SWAP = "sensor_swap"
    INTENSITY_SCALE = "intensity_scale"
    DROPPED_SECTOR = "dropped_sector"
    TIME_JITTER = "time_jitter"


DISTURBANCE_MEANS: Final[Mapping[DisturbanceKind, str]] = {
    DisturbanceKind.ODOMETRY_SLIP: "poses slip for 0.2 to 0.5 s when the log is evaluated",
    DisturbanceKind.GROUND_LEAK: "patches of the ground in a sector are lifted, as by spray",
    DisturbanceKind.SENSOR_SWAP: "a lidar of half the rows, slightly rotated and mounted higher",
    DisturbanceKind.INTENSITY_SCALE: "all intensities are scaled, by 0.2 to 4",
    DisturbanceKind.DROPPED_SECTOR: "a sector of 40 to 90 degrees is missing",
    DisturbanceKind.TIME_JITTER: "stamps of frames are up to 0.04 s late",
}
"""Effect of each kind of disturbance on the recording; the on-board model's labels stay right."""


@dataclass(frozen=True, slots=True)
class PlannedFailure:
    """A failure planned for a scene.

    Attributes:
        cell: Number of the scene in its log, from 0.
        kind: Its kind.
        common_mode: Whether the self-supervised stream should tend to fail on it too.
    """

    cell: int
    kind: FailureKind
    common_mode: bool = False


@dataclass(frozen=True, slots=True)
class PlannedDisturbance:
    """A disturbance planned for a scene.

    Attributes:
        cell: Number of the scene in its log, from 0.
        kind: Its kind.
        seed: Seed of its strength and place.
    """

    cell: int
    kind: DisturbanceKind
    seed: int


@dataclass(frozen=True, slots=True)
class LogPlan:
    """Plan of one log of a fleet.

    Attributes:
        number: Number of the log in its fleet, from 0.
        seed: Seed of its street and of everything in it.
        scenes: Number of its scenes.
        hard: Dense traffic, vegetation, turns, bumps.
        software_version: Software version of the car.
        failures: Planned failures, by scene; at most one per scene.
        disturbances: Planned disturbances, by scene; at most one per scene.
        lifelike: Whether the labels have the noise of a real model, ghosts stick to structure, and
            the model may be wrong from the first frame on.
        begin_s: Part of the drive before the first frame, seconds.
        first_drive: Number of the first log of the same street, whose car decides where failures
            are planted; None: this log.
    """

    number: int
    seed: int
    scenes: int
    hard: bool
    software_version: str
    failures: tuple[PlannedFailure, ...] = ()
    disturbances: tuple[PlannedDisturbance, ...] = ()
    lifelike: bool = False
    begin_s: float = 0.0
    first_drive: int | None = None

    @property
    def kinds(self) -> tuple[FailureKind, ...]:
        """Kinds of failures that may be planted in it, common-mode failures aside."""
        return LIFELIKE_KINDS if self.lifelike else DRAWN_KINDS

    @property
    def seconds(self) -> float:
        """Duration of the log, seconds."""
        return self.scenes * SCENE_S

    @property
    def wants_common_mode(self) -> bool:
        """True if the street should contain objects that both streams tend to miss.

        Such objects are pedestrians under 1 m/s, vehicles over 18 m, and movers along a wall
        (`candidates.py`).
        """
        return any(each.common_mode for each in self.failures)


def plan_fleet(
    *,
    scenes: int,
    seed: int,
    share: float,
    disturbed_share: float = DISTURBED_SHARE,
    hard_share: float = HARD_SHARE,
    common_mode_share: float = COMMON_MODE_SHARE,
    lifelike: bool = False,
    log_s: tuple[float, float] | None = None,
) -> tuple[LogPlan, ...]:
    """Draw the plan of a fleet; numbers are exact, places are drawn.

    Failures, disturbances and hard logs are drawn independently of one another. Kinds are equally
    likely: as many of each as the number allows. Versions alternate, and regressions of a version
    are planned only in logs that run it.

    Args:
        scenes: Scenes of the fleet; the last log may be shorter than the others.
        seed: Seed of the plan.
        share: Share of the scenes that carry a failure, 0 to 1.
        disturbed_share: Share of the scenes that carry a disturbance.
        hard_share: Share of the logs that are hard.
        common_mode_share: Share of the failures that are common-mode.
        lifelike: Whether the logs are lifelike (`LogPlan`).
        log_s: Shortest and longest log, seconds, at least one scene; 20 s when None, and
            `LIFELIKE_LOG_S` of lifelike logs.

    Raises:
        ValueError: If a share is outside 0 to 1, there is no scene, or a log has none.
    """
    shares = (share, disturbed_share, hard_share, common_mode_share)
    if scenes < 1 or not all(0.0 <= each <= 1.0 for each in shares):
        raise ValueError(f"a fleet needs scenes and shares of 0 to 1, got {scenes} and {shares}")
    shortest_s, longest_s = log_s or (LIFELIKE_LOG_S if lifelike else (LOG_S, LOG_S))
    if not SCENE_S <= shortest_s <= longest_s:
        raise ValueError(f"a log lasts {SCENE_S} s or longer, got {shortest_s} to {longest_s} s")
    draw = [np.random.default_rng([seed, 0xF1EE7, purpose]) for purpose in range(6)]
    counts = _scenes_of_logs(scenes, shortest_s, longest_s, draw[4])
    logs, log_of = len(counts), np.repeat(np.arange(len(counts)), counts)
    first = np.cumsum([0, *counts])
    failing = sorted(draw[0].choice(scenes, round(share * scenes), replace=False).tolist())
    kinds = LIFELIKE_KINDS if lifelike else DRAWN_KINDS
    failures = _failures(failing, log_of.tolist(), common_mode_share, kinds, draw[1])
    disturbed = sorted(draw[2].choice(scenes, round(disturbed_share * scenes), replace=False))
    what = balanced(tuple(DisturbanceKind), len(disturbed), draw[2])
    hard = set(draw[3].choice(logs, round(hard_share * logs), replace=False).tolist())
    seeds = np.random.SeedSequence([seed, 0x106]).generate_state(logs)
    begins_s = draw[5].uniform(*_BEGINS_S, logs).round(2) if lifelike else np.zeros(logs)
    return tuple(
        LogPlan(
            number=number,
            seed=int(seeds[number]),
            scenes=counts[number],
            hard=number in hard,
            software_version=VERSIONS[number % len(VERSIONS)],
            failures=tuple(
                PlannedFailure(cell - int(first[number]), *each)
                for cell, each in failures.items()
                if log_of[cell] == number
            ),
            disturbances=tuple(
                PlannedDisturbance(int(cell - first[number]), kind, int(seeds[number]) + int(cell))
                for cell, kind in zip(disturbed, what, strict=True)
                if log_of[cell] == number
            ),
            lifelike=lifelike,
            begin_s=float(begins_s[number]),
        )
        for number in range(logs)
    )


def _scenes_of_logs(
    scenes: int, shortest_s: float, longest_s: float, rng: np.random.Generator
) -> list[int]:
    """Divide the scenes of a fleet among logs of equal or drawn length."""
    least, most = round(shortest_s / SCENE_S), round(longest_s / SCENE_S)
    counts: list[int] = []
    while (left := scenes - sum(counts)) > 0:
        drawn = most if least == most else int(rng.integers(least, most + 1))
        counts.append(min(drawn, left))
    return counts


def _failures(
    cells: list[int],
    log_of: Sequence[int],
    common_mode_share: float,
    drawn_kinds: tuple[FailureKind, ...],
    rng: np.random.Generator,
) -> dict[int, tuple[FailureKind, bool]]:
    """Assign a kind to each failing scene; the regression goes to logs of its version."""
    order = [int(cell) for cell in rng.permutation(cells)]
    common = order[: round(common_mode_share * len(order))]
    rest = order[len(common) :]
    kinds = balanced(drawn_kinds, len(rest), rng)
    wanted = kinds.count(FailureKind.VERSION_REGRESSION)
    fits = [c for c in rest if VERSIONS[log_of[c] % len(VERSIONS)] == REGRESSED_VERSION]
    regressed = fits[:wanted]
    others = [cell for cell in rest if cell not in regressed]
    plain = [kind for kind in kinds if kind is not FailureKind.VERSION_REGRESSION]
    plain += balanced(
        tuple(kind for kind in drawn_kinds if kind is not FailureKind.VERSION_REGRESSION),
        len(others) - len(plain),
        rng,
    )
    chosen = dict.fromkeys(common, (FailureKind.MISSED_MOVER, True))
    chosen |= dict.fromkeys(regressed, (FailureKind.VERSION_REGRESSION, False))
    chosen |= {cell: (kind, False) for cell, kind in zip(others, plain, strict=True)}
    return {cell: chosen[cell] for cell in cells}


def balanced(kinds: tuple[Kind, ...], count: int, rng: np.random.Generator) -> list[Kind]:
    """Return equally many of each kind, as far as `count` allows, in random order."""
    turns = [kinds[i] for _ in range(ceil(count / len(kinds))) for i in rng.permutation(len(kinds))]
    return [turns[i] for i in rng.permutation(count)]
