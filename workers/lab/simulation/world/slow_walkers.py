"""Slow pedestrians: speeds and paths that are easily mistaken for standing."""

from typing import Final

import numpy as np

from workers.lab.simulation.world.facades import garden_line_m
from workers.lab.simulation.world.street_kinds import Place

WALK_M_PER_S: Final = (1.0, 1.8)
STROLL_M_PER_S: Final = (0.54, 0.8)
"""Speeds with a stick, a pram or a shop window, m/s; truth is unknown at 0.5 and below."""

_BRISK_SHARE: Final = 0.35
_BY_WALL_SHARE: Final = 0.5
"""Share of these pedestrians close to a wall; a brisk walker is one of them only there."""

_FROM_WALL_M: Final = 0.8


def draw_stroll(place: Place, rng: np.random.Generator) -> tuple[float, float]:
    """Draw a walking speed, m/s, and a distance from the middle of the road, metres."""
    where = rng.random()
    walk_m_per_s = float(rng.uniform(*(WALK_M_PER_S if where < _BRISK_SHARE else STROLL_M_PER_S)))
    across_m = place.kerb_m + float(rng.uniform(0.6, 1.8))
    if where < _BY_WALL_SHARE:
        across_m = _wall_m(place) - _FROM_WALL_M
    return walk_m_per_s, across_m


def _wall_m(place: Place) -> float:
    """Return the distance of façades or garden fences from the middle of the road, metres."""
    return garden_line_m(place) if place.gardens else place.facade_m
