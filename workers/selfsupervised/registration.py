"""Where each cluster was a moment ago: rigid registration to earlier frames, by translation."""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.selfsupervised.clusters import Clusters
from workers.selfsupervised.compiled import compiled
from workers.selfsupervised.neighbours import PointGrid, build_grid, nearest
from workers.selfsupervised.occupancy import (
    CELL_M,
    Occupancy,
    build_occupancy,
    cells_of,
    score_at,
)

MIN_POINTS: Final = 5
MAX_EXTENT_M: Final = 18.0
"""An articulated bus or lorry; longer clusters are walls."""

MAX_SPEED_M_PER_S: Final = 30.0
STILL_M: Final = 0.10
"""Mean nearest distance of a cluster that was where it is: half a voxel and the pose error."""

ENERGY_REACH_M: Final = 0.5
_SAMPLES: Final = 150
_COARSE_SAMPLES: Final = 50
_ICP_REACH_M: Final = 0.6
_ICP_SCALE_M: Final = 0.15
_ICP_STEPS: Final = 8
_ICP_DONE_M: Final = 0.01
_MIN_GAIN_M: Final = 0.01
_DISTANCE_PENALTY_PER_M: Final = 0.004
_BACK_WINDOW_M: Final = 1.2
_UNSEEN_SHIFT_M: Final = 0.6
"""A side that passes us lies on itself when shifted by less: the near frame cannot tell."""

_MAX_WINDOW_M: Final = 3.6


class Reference(NamedTuple):
    """An earlier frame, ready to be registered to.

    Attributes:
        grid: Its points, for nearest neighbours.
        occupancy: Its points, for the coarse search.
        age_s: How much earlier it was.
    """

    grid: PointGrid
    occupancy: Occupancy
    age_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """How well each of K clusters fits the near (0.1 s) and the far (0.5 s) reference.

    Energies are mean nearest distances in metres, at most 0.5; shifts take a cluster back to
    where it was.

    Attributes:
        tried: (K,) large enough and not larger than a vehicle.
        extent_m: (K,) longest horizontal side of its box.
        still_energy_far: (K,) energy in the far reference if it had not moved.
        still_energy_near: (K,) the same in the near reference; NaN where not computed.
        energy_far: (K,) after the best shift.
        energy_near: (K,) after the best shift.
        shift_far_m: (K, 3) best shift to the far reference.
        shift_near_m: (K, 3) best shift to the near reference.
        energy_between: (K,) in the near reference, after the part of the far shift that is due.
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


def build_reference(points_m: Points, centre_m: NDArray[np.floating], age_s: float) -> Reference:
    """Make an earlier frame ready to be registered to.

    Args:
        points_m: (N, 3) its voxel centroids off the ground, odom space.
        centre_m: (3,) where its sensor was, odom space.
        age_s: How much earlier it was than the frame to register.
    """
    return Reference(build_grid(points_m, centre_m), build_occupancy(points_m, centre_m), age_s)


def register(points_m: Points, clusters: Clusters, near: Reference, far: Reference) -> Registered:
    """Look for the shift that takes each cluster back to where it was.

    Near reference: all shifts up to 30 m/s on a coarse occupancy grid, the three best refined by
    ICP. Far reference: around what the near one predicts and around standing still. The long
    baseline makes the velocity exact, the short one makes the search small.

    Args:
        points_m: (N, 3) voxel centroids, odom space.
        clusters: Sets of them.
        near: The frame about 0.1 s ago.
        far: The frame about 0.5 s ago.
    """
    table = _register_all(points_m, clusters.members, clusters.start, near, far)
    return Registered(
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
def _energy(grid: PointGrid, points: Points, sx: float, sy: float, sz: float) -> float:
    total = 0.0
    for i in range(len(points)):
        squared, _ = nearest(
            grid, points[i, 0] + sx, points[i, 1] + sy, points[i, 2] + sz, ENERGY_REACH_M
        )
        total += np.sqrt(squared)
    return total / len(points)


@compiled
def _refine(grid: PointGrid, points: Points, shift: NDArray[np.float64]) -> None:
    """Translation-only ICP; outliers count less, (d/0.15)^2."""
    for _ in range(_ICP_STEPS):
        mx, my, mz, total = 0.0, 0.0, 0.0, 0.0
        for i in range(len(points)):
            x, y, z = points[i, 0] + shift[0], points[i, 1] + shift[1], points[i, 2] + shift[2]
            squared, j = nearest(grid, x, y, z, _ICP_REACH_M)
            if j < 0:
                continue
            weight = 1.0 / (1.0 + squared / (_ICP_SCALE_M * _ICP_SCALE_M))
            mx += weight * (grid.points_m[j, 0] - x)
            my += weight * (grid.points_m[j, 1] - y)
            mz += weight * (grid.points_m[j, 2] - z)
            total += weight
        if total == 0.0:
            return
        mx, my, mz = mx / total, my / total, mz / total
        shift[0] += mx
        shift[1] += my
        shift[2] += mz
        if mx * mx + my * my + mz * mz < _ICP_DONE_M * _ICP_DONE_M:
            return


@compiled
def _search(
    reference: Reference,
    points: Points,
    centre: NDArray[np.float64],
    window: float,
    keep: int,
    best: NDArray[np.float64],
) -> None:
    """Best shift within a square window about a centre: coarse score, then ICP on the best few.

    `best` holds the best shift so far and its energy, and is improved in place.
    """
    occupancy, grid = reference.occupancy, reference.grid
    # cells are twice as coarse as voxels: a third of the points says as much about them
    cells = cells_of(occupancy, points[:: max(1, len(points) // _COARSE_SAMPLES)])
    reach = int(np.ceil(window / CELL_M))
    cx, cy = int(np.round(centre[0] / CELL_M)), int(np.round(centre[1] / CELL_M))
    side = 2 * reach + 1
    score = np.empty((side, side), np.float64)
    for i in range(side):
        for j in range(side):
            dx, dy = cx + i - reach, cy + j - reach
            away = CELL_M * np.sqrt(float(dx * dx + dy * dy))
            score[i, j] = score_at(occupancy, cells, dx, dy) - _DISTANCE_PENALTY_PER_M * away
    shift = np.empty(3, np.float64)
    for _ in range(keep):
        flat = int(np.argmax(score))
        top_i, top_j = flat // side, flat % side
        if score[top_i, top_j] <= -1.0:
            return
        for i in range(max(0, top_i - 2), min(side, top_i + 3)):
            for j in range(max(0, top_j - 2), min(side, top_j + 3)):
                score[i, j] = -2.0
        shift[0] = (cx + top_i - reach) * CELL_M
        shift[1] = (cy + top_j - reach) * CELL_M
        shift[2] = centre[2]
        _refine(grid, points, shift)
        energy = _energy(grid, points, shift[0], shift[1], shift[2])
        if energy < best[3]:
            best[:3] = shift
            best[3] = energy


@compiled
def _sample(points: Points, members: NDArray[np.int32]) -> Points:
    """Up to 150 members, evenly spread over the order of the points: no randomness."""
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
        still_far = _energy(far.grid, sample, 0.0, 0.0, 0.0)
        table[k, 2] = still_far
        table[k, 4] = still_far
        if still_far < STILL_M:
            continue
        still_near = _energy(near.grid, sample, 0.0, 0.0, 0.0)
        table[k, 3] = still_near
        best[:3], best[3] = 0.0, still_near
        _search(near, sample, origin, MAX_SPEED_M_PER_S * near.age_s, 3, best)
        if still_near - best[3] < _MIN_GAIN_M:
            best[:3], best[3] = 0.0, still_near
        table[k, 5] = best[3]
        table[k, 9:12] = best[:3]
        predicted = best[:3] * (far.age_s / near.age_s)
        away = np.sqrt(predicted[0] * predicted[0] + predicted[1] * predicted[1])
        best[:3], best[3] = 0.0, still_far
        if away > _BACK_WINDOW_M:
            _search(far, sample, predicted, _BACK_WINDOW_M, 2, best)
        window = max(_BACK_WINDOW_M, _UNSEEN_SHIFT_M * far.age_s / near.age_s)
        _search(far, sample, origin, min(window, _MAX_WINDOW_M), 3, best)
        table[k, 4] = best[3]
        table[k, 6:9] = best[:3]
        part = best[:3] * (near.age_s / far.age_s)
        table[k, 12] = _energy(near.grid, sample, part[0], part[1], part[2])
    return table
