"""Fault placement: assigns the planned failures of a log to tracks of its street.

A failure without a candidate in its scene moves to another scene of the log. Where no scene has
one, another kind is drawn. Both are recorded.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from workers.lab.simulation.faults.candidates import (
    Candidate,
    SceneVisibility,
    candidates_of,
    measure_visibility,
)
from workers.lab.simulation.faults.faults import PlantedFailure
from workers.lab.simulation.faults.plan import (
    SCENE_S,
    FailureKind,
    LogPlan,
    PlannedFailure,
)
from workers.lab.simulation.faults.structure_ghosts import structure_ghosts
from workers.lab.simulation.sensor.lidar import SimulatedFrame
from workers.lab.simulation.world.street import Street

LEAST_S: Final = 0.6
"""Shortest failure, seconds: half a second makes a failure, and frames are up to 0.1 s apart."""

_FLICKER_LEAST_S: Final = 1.2
"""Shortest flicker, seconds: a flickering object is wrong for two thirds of the time only."""

_SETTLED_S: Final = 1.2
"""Start of the first failure, seconds: before it, the streams have no past to contradict with."""

_HALF_LEAST_S: Final = 1.0
"""Shortest time for which a large mover is half labelled, seconds."""

_HALF_SHARE: Final = (0.55, 0.85)
"""Share of its points that are then labelled static: more than half, which makes a failure."""

_LEAST_S_OF: Final[Mapping[FailureKind, float]] = {
    FailureKind.FLICKER: _FLICKER_LEAST_S,
    FailureKind.HALF_LABELLED: _HALF_LEAST_S,
}

_WRONG_AT_FIRST: Final = 0.5
"""Share of the failures at the start of a lifelike log that begin with its first frame."""


@dataclass(frozen=True, slots=True)
class Redraw:
    """A planned failure without a candidate in its scene.

    Attributes:
        planned: The failure in the fleet's plan.
        kind: Kind planted instead; None: nothing.
        cell: Its scene.
    """

    planned: PlannedFailure
    kind: FailureKind | None
    cell: int


def place_failures(
    street: Street,
    plan: LogPlan,
    *,
    frame_at: Callable[[int], SimulatedFrame],
    period_s: float,
) -> tuple[tuple[PlantedFailure, ...], tuple[Redraw, ...]]:
    """Choose an object and a time window for every planned failure of a log.

    Args:
        street: The street of the log.
        plan: Planned failures of the log.
        frame_at: Returns the frame of a number, with its disturbances.
        period_s: Time between frames.

    Returns:
        One failure for each planned one that has a candidate anywhere, and the moved or redrawn
        ones.
    """
    rng = np.random.default_rng([plan.seed, 0xBAD])
    views: dict[int, SceneVisibility] = {}

    def view(cell: int) -> SceneVisibility:
        if cell not in views:
            first = max(cell * SCENE_S, _SETTLED_S)
            views[cell] = measure_visibility(
                street, frame_at, from_s=first, to_s=(cell + 1) * SCENE_S, period_s=period_s
            )
        return views[cell]

    planted: list[PlantedFailure] = []
    redraws: list[Redraw] = []
    taken = {each.cell for each in plan.failures}
    for planned in plan.failures:
        free = [cell for cell in range(plan.scenes) if cell not in taken]
        found = None
        for kind, cell in _tries(planned, free, plan.kinds, rng):
            shared = planned.common_mode and kind is FailureKind.MISSED_MOVER
            pace = partial(_pace, street) if shared else None
            found = plant_in_scene(view(cell), kind, cell, rng, pace=pace, lifelike=plan.lifelike)
            if found is not None:
                break
        taken.discard(planned.cell)
        if found is not None:
            planted.append(found)
            taken.add(found.cell)
        if found is None or (found.kind, found.cell) != (planned.kind, planned.cell):
            became, cell = (None, planned.cell) if found is None else (found.kind, found.cell)
            redraws.append(Redraw(planned, became, cell))
    planted.sort(key=lambda each: each.start_s)
    return tuple(planted), tuple(redraws)


def _tries(
    planned: PlannedFailure,
    free: Sequence[int],
    kinds: Sequence[FailureKind],
    rng: np.random.Generator,
) -> Iterator[tuple[FailureKind, int]]:
    """Yield the kind in its scene, the kind in other scenes, then other kinds in its scene."""
    yield planned.kind, planned.cell
    for cell in rng.permutation(len(free)):
        yield planned.kind, free[cell]
    others = [kind for kind in kinds if kind is not planned.kind]
    for place in rng.permutation(len(others)):
        yield others[place], planned.cell


def plant_in_scene(
    view: SceneVisibility,
    kind: FailureKind,
    cell: int,
    rng: np.random.Generator,
    *,
    pace: Callable[[Candidate], tuple[float, int]] | None = None,
    lifelike: bool = False,
) -> PlantedFailure | None:
    """Choose an object and a time window for a failure of one scene; None without a candidate.

    Args:
        view: Visibility of the scene's objects.
        kind: Kind of the failure.
        cell: Number of the scene in its log.
        rng: Source of the choice.
        pace: Of a common-mode failure: speed of a candidate, of which the slowest is chosen.
        lifelike: Whether ghosts stick to structure, and failures may begin with the log.
    """
    shared = pace is not None
    least_s = _LEAST_S_OF.get(kind, LEAST_S)
    if kind is FailureKind.GHOST_MOVER and lifelike:
        every = list(structure_ghosts(view))
    else:
        every = candidates_of(view, kind, common_mode=shared)
    able = [each for each in every if each.lasts_s >= least_s]
    if not able:
        return None
    # a stream without lookahead misses slow movers of every class
    chosen = able[int(rng.integers(len(able)))] if pace is None else min(able, key=pace)
    start_s, end_s = _window(chosen, kind, least_s, rng)
    if lifelike and cell == 0 and kind is not FailureKind.LATE_DETECTION:
        begins = chosen.start_s <= view.times_s[0] and rng.random() < _WRONG_AT_FIRST
        start_s = 0.0 if begins else start_s
    place_m = chosen.place_m
    if place_m is not None:
        slid = [each * (start_s - chosen.start_s) for each in chosen.slides_m_per_s]
        place_m = round(place_m[0] + slid[0], 2), round(place_m[1] + slid[1], 2), place_m[2]
    half = kind is FailureKind.HALF_LABELLED
    return PlantedFailure(
        kind=kind,
        track=chosen.track,
        start_s=round(start_s, 3),
        end_s=round(end_s, 3),
        other_track=chosen.other_track,
        place_m=place_m,
        range_m=chosen.range_m,
        cell=cell,
        common_mode=shared,
        because=chosen.because,
        class_name=chosen.class_name,
        radius_m=chosen.radius_m,
        slides_m_per_s=chosen.slides_m_per_s,
        part=round(float(rng.uniform(*_HALF_SHARE)), 3) if half else 1.0,
    )


def _pace(street: Street, each: Candidate) -> tuple[float, int]:
    """Return the true straight-line speed of a mover, m/s, and its number."""
    early, late = (
        street.actor_poses(time_s)[each.track, :2]
        for time_s in (each.start_s, each.start_s + each.lasts_s)
    )
    return float(np.hypot(*(late - early))) / each.lasts_s, each.track


def _window(
    chosen: Candidate, kind: FailureKind, least_s: float, rng: np.random.Generator
) -> tuple[float, float]:
    lasts_s = float(rng.uniform(least_s, chosen.lasts_s))
    if kind is FailureKind.LATE_DETECTION:
        return chosen.start_s, chosen.start_s + lasts_s
    start_s = chosen.start_s + float(rng.uniform(0.0, max(chosen.lasts_s - lasts_s, 0.0)))
    return start_s, start_s + lasts_s
