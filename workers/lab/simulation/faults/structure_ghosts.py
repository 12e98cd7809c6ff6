"""Ghosts that stick to what stands: on walls, hedges, fences and parked cars of a lifelike log.

A network labels a piece of structure a moving car for a while. The points stand. The label stays on
them, or slides along the structure as its visible part changes.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.lab.simulation.faults.candidates import (
    ENOUGH_POINTS,
    Candidate,
    SceneVisibility,
    longest_run,
)
from workers.lab.simulation.faults.faults import STATIC, TrueFrame, ghost_points
from workers.lab.simulation.models.kinds import StreetClass

STRUCTURE: Final = (
    StreetClass.BUILDING,
    StreetClass.VEGETATION,
    StreetClass.TRUNK,
    StreetClass.FENCE,
    StreetClass.OBJECT,
    StreetClass.POLE,
    StreetClass.SIGN,
)

_RANGE_M: Final = (4.0, 35.0)
_HIGHEST_M: Final = 2.0
"""Height of a ghost over the sensor, metres: where road users are."""

_TRIES: Final = 24
_RADIUS_M: Final = (0.8, 2.2)
_SLIDES_SHARE: Final = 0.4
_SLIDES_M_PER_S: Final = (0.5, 4.0)
_ALONG_M: Final = 3.0
"""Radius in which the direction of a wall is measured, metres."""

_ON_CAR_SHARE: Final = 0.3
"""Share of the tries on parked vehicles."""

_MOST_OF_CAR: Final = 0.6
_CAR_RADIUS_M: Final = 2.8


def structure_ghosts(view: SceneVisibility) -> Iterator[Candidate]:
    """Yield places on structure and parked vehicles that can carry a ghost, in a fixed order."""
    first = view.frames[0]
    rng = np.random.default_rng([view.street.seed, first.index, 0x6057])
    range_m = np.hypot(first.points_m[:, 0], first.points_m[:, 1])
    near = (range_m > _RANGE_M[0]) & (range_m < _RANGE_M[1])
    near &= (first.points_m[:, 2] < _HIGHEST_M) & (first.ground == 0)
    on_structure = np.flatnonzero(near & (first.track < 0) & np.isin(first.class_id, STRUCTURE))
    parked = np.unique(first.track[near & (first.track >= 0) & (first.motion == STATIC)])
    for _ in range(_TRIES):
        on_car, pick = rng.random() < _ON_CAR_SHARE, rng.random()
        if on_car and len(parked):
            found = _on_parked(view, int(parked[int(pick * len(parked))]))
        elif len(on_structure):
            found = _on_structure(view, int(on_structure[int(pick * len(on_structure))]), rng)
        else:
            found = None
        if found is not None:
            yield found


def _on_parked(view: SceneVisibility, track: int) -> Candidate | None:
    """Put a ghost on a parked vehicle and on what stands next to it."""
    seen = np.zeros(len(view.frames), np.bool_)
    middle_m = np.nanmean(view.centre_m[:, track], axis=0) if _is_seen(view, track) else None
    if middle_m is None:
        return None
    for number, frame in enumerate(view.frames):
        mine = frame.track == track
        ghost = ghost_points(frame, middle_m, radius_m=_CAR_RADIUS_M, track=track) & mine
        seen[number] = ghost.sum() >= max(ENOUGH_POINTS, _MOST_OF_CAR * mine.sum())
    run = longest_run(view, seen)
    if run is None:
        return None
    name = view.street.actors[track].street_class.name.lower()
    return Candidate(
        track, *run, place_m=_rounded(middle_m), class_name=name, radius_m=_CAR_RADIUS_M
    )


def _is_seen(view: SceneVisibility, track: int) -> bool:
    return bool(np.isfinite(view.centre_m[:, track]).any())


def _on_structure(view: SceneVisibility, point: int, rng: np.random.Generator) -> Candidate | None:
    """Put a ghost on a point of the structure; some slide along it."""
    first = view.frames[0]
    pose = first.world_from_sensor
    place_m = pose[:3, :3] @ first.points_m[point].astype(np.float64) + pose[:3, 3]
    radius_m = round(float(rng.uniform(*_RADIUS_M)), 2)
    slides = np.zeros(2)
    if rng.random() < _SLIDES_SHARE:
        pace = float(rng.uniform(*_SLIDES_M_PER_S)) * (1.0 if rng.random() < 0.5 else -1.0)
        slides = (pace * _direction_of(first, point)).round(3)
    seen = np.zeros(len(view.frames), np.bool_)
    for number, frame in enumerate(view.frames):
        slid = np.array([*slides, 0.0]) * (frame.time_s - first.time_s)
        ghost = ghost_points(frame, place_m + slid, radius_m=radius_m)
        seen[number] = ghost.sum() >= ENOUGH_POINTS
    run = longest_run(view, seen)
    if run is None:
        return None
    begins_m = place_m + np.array([*slides, 0.0]) * (run[0] - first.time_s)
    return Candidate(
        -1,
        *run,
        place_m=_rounded(begins_m),
        class_name=StreetClass(int(first.class_id[point])).name.lower(),
        radius_m=radius_m,
        slides_m_per_s=(float(slides[0]), float(slides[1])),
    )


def _direction_of(frame: TrueFrame, point: int) -> NDArray[np.float64]:
    """Return the horizontal direction of the structure around a point, world space."""
    away_m = frame.points_m - frame.points_m[point]
    near = ((away_m**2).sum(axis=1) < _ALONG_M**2) & (frame.track < 0) & (frame.ground == 0)
    world = frame.points_m[near].astype(np.float64) @ frame.world_from_sensor[:3, :3].T
    centred = world[:, :2] - world[:, :2].mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    return np.asarray(axes[:, -1])


def _rounded(place_m: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = place_m.round(2).tolist()
    return x, y, z
