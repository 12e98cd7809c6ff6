"""Rigid registration of clusters to earlier frames, by translation."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.points.clusters import Clusters
from workers.points.compiled import compiled
from workers.points.step_names import step
from workers.selfsupervised.translation_search import (
    Reference,
    build_reference,
    energy_of,
    reference_to,
    search,
)

__all__ = ["Reference", "RegistrationResiduals", "build_reference", "reference_to", "register"]

MIN_POINTS: Final = 5
MAX_EXTENT_M: Final = 18.0
"""Longest side of a vehicle, metres: an articulated bus or lorry; longer clusters are walls."""

MAX_SPEED_M_PER_S: Final = 30.0
STILL_M: Final = 0.10
"""Mean nearest distance of a cluster that did not move, metres: half a voxel and the pose error."""

_SAMPLES: Final = 150
_MIN_GAIN_M: Final = 0.01
_BACK_WINDOW_M: Final = 1.2
_UNSEEN_SHIFT_M: Final = 0.6
"""Shift of the near frame that is not observable, metres: the side of a passing object overlaps
itself when shifted by less."""

_MAX_WINDOW_M: Final = 3.6


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationResiduals:
    """Registration residuals of K clusters to the near (0.1 s) and the far (0.5 s) reference.

    Energies are mean nearest distances in metres, at most 0.5; shifts take a cluster back to
    its earlier place.

    Attributes:
        tried: (K,) clusters of at least 5 points and at most the length of a vehicle.
        extent_m: (K,) longest horizontal side of the box.
        still_energy_far: (K,) energy in the far reference without a shift.
        still_energy_near: (K,) the same in the near reference; NaN where not computed.
        energy_far: (K,) after the best shift.
        energy_near: (K,) after the best shift.
        shift_far_m: (K, 3) best shift to the far reference.
        shift_near_m: (K, 3) best shift to the near reference.
        energy_between: (K,) in the near reference, after the far shift scaled to its age.
    """

    tried: NDArray[np.bool_]
    extent_m: NDArray[np.float32]
    still_energy_far: NDArray[np.float32]
    still_energy_near: NDArray[np.float32]
    energy_far: NDArray[np.float32]
    energy_near: NDArray[np.float32]
    shift_far_m: NDArray[np.float32]
    shift_near_m: NDArray[np.float32]
    energy_between: NDArray[np.float32]


@step("registration")
def register(
    points_m: Points, clusters: Clusters, near: Reference, far: Reference
) -> RegistrationResiduals:
    """Find the shift that takes each cluster back to its earlier place.

    Near reference: all shifts up to 30 m/s on a coarse occupancy grid, the three best refined by
    ICP. Far reference: shifts around the near one's prediction and around zero. The long baseline
    makes the velocity exact, the short one makes the search small.

    Args:
        points_m: (N, 3) voxel centroids, odom space.
        clusters: Sets of them.
        near: The frame about 0.1 s ago.
        far: The frame about 0.5 s ago.
    """
    table = _register_all(points_m, clusters.members, clusters.start, near, far)
    return RegistrationResiduals(
        tried=table[:, 0] > 0,
        extent_m=table[:, 1],
        still_energy_far=table[:, 2],
        still_energy_near=table[:, 3],
        energy_far=table[:, 4],
        energy_near=table[:, 5],
        shift_far_m=table[:, 6:9],
        shift_near_m=table[:, 9:12],
        energy_between=table[:, 12],
    )


@compiled
def _sample(points: Points, members: NDArray[np.int32]) -> Points:
    """Select up to 150 members, evenly spread over the order of the points, without randomness."""
    n = min(len(members), _SAMPLES)
    sample = np.empty((n, 3), np.float32)
    for i in range(n):
        sample[i] = points[members[i * len(members) // n]]
    return sample


@compiled
def _register_all(
    points: Points,
    members: NDArray[np.int32],
    start: NDArray[np.int32],
    near: Reference,
    far: Reference,
) -> NDArray[np.float32]:
    count = len(start) - 1
    table = np.zeros((count, 13), np.float32)
    best = np.empty(4, np.float64)
    origin = np.zeros(3, np.float64)
    for k in range(count):
        inside = members[start[k] : start[k + 1]]
        low, high = points[inside[0]].copy(), points[inside[0]].copy()
        for i in inside:
            for axis in range(2):
                low[axis] = min(low[axis], points[i, axis])
                high[axis] = max(high[axis], points[i, axis])
        extent = max(high[0] - low[0], high[1] - low[1])
        table[k, 1] = extent
        table[k, 2:6] = np.nan
        table[k, 12] = np.nan
        if len(inside) < MIN_POINTS or extent > MAX_EXTENT_M:
            continue
        table[k, 0] = 1.0
        sample = _sample(points, inside)
        no_rows = np.full(len(sample), -1, np.int32)
        still_far = energy_of(far.grid, sample, 0.0, 0.0, 0.0, no_rows.copy(), np.inf)
        table[k, 2] = still_far
        table[k, 4] = still_far
        if still_far < STILL_M:
            continue
        still_near = energy_of(near.grid, sample, 0.0, 0.0, 0.0, no_rows.copy(), np.inf)
        table[k, 3] = still_near
        best[:3], best[3] = 0.0, still_near
        search(near, sample, origin, MAX_SPEED_M_PER_S * near.age_s, 3, best)
        if still_near - best[3] < _MIN_GAIN_M:
            best[:3], best[3] = 0.0, still_near
        table[k, 5] = best[3]
        table[k, 9:12] = best[:3]
        predicted = best[:3] * (far.age_s / near.age_s)
        away = np.sqrt(predicted[0] * predicted[0] + predicted[1] * predicted[1])
        best[:3], best[3] = 0.0, still_far
        if away > _BACK_WINDOW_M:
            search(far, sample, predicted, _BACK_WINDOW_M, 2, best)
        window = max(_BACK_WINDOW_M, _UNSEEN_SHIFT_M * far.age_s / near.age_s)
        search(far, sample, origin, min(window, _MAX_WINDOW_M), 3, best)
        table[k, 4] = best[3]
        table[k, 6:9] = best[:3]
        part = best[:3] * (near.age_s / far.age_s)
        table[k, 12] = energy_of(near.grid, sample, part[0], part[1], part[2], no_rows, np.inf)
    return table
