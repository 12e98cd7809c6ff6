"""Who walks so slowly, or so close to a wall, that it is easily taken for standing."""

from typing import Final

import numpy as np

from workers.lab.simulation.world.facades import garden_line_m
from workers.lab.simulation.world.street_kinds import Place

WALK_M_PER_S: Final = (1.0, 1.8)
STROLL_M_PER_S: Final = (0.54, 0.8)
"""With a stick, a pram, a shop window. Truth says of 0.5 and below that nobody knows."""

_BRISK_SHARE: Final = 0.35
_BY_WALL_SHARE: Final = 0.5
"""Of those who are easily taken for standing; who walks briskly is one of them only by a wall."""

_FROM_WALL_M: Final = 0.8


def draw_stroll(place: Place, rng: np.random.Generator) -> tuple[float, float]:
    """Draw how fast somebody walks, in m/s, and how far from the middle of the road, in metres."""
    where = rng.random()
    walk_m_per_s = float(rng.uniform(*(WALK_M_PER_S if where < _BRISK_SHARE else STROLL_M_PER_S)))
    across_m = place.kerb_m + float(rng.uniform(0.6, 1.8))
    if where < _BY_WALL_SHARE:
        across_m = _wall_m(place) - _FROM_WALL_M
    return walk_m_per_s, across_m


def _wall_m(place: Place) -> float:
    """What people walk along: fronts, or fences of gardens; from the middle of the road."""
    return garden_line_m(place) if place.gardens else place.facade_m
