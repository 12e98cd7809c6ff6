"""Translation search: the best shift of a cluster within a window, coarse cells first, then ICP."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.points.compiled import compiled, inlined
from workers.points.neighbours import PointGrid, build_grid, nearer
from workers.points.step_names import step
from workers.selfsupervised.occupancy import (
    CELL_M,
    Occupancy,
    build_occupancy,
    cells_of,
    scores_around,
)

ENERGY_REACH_M: Final = 0.5
_COARSE_SAMPLES: Final = 50
_ICP_REACH_M: Final = 0.6
_ICP_SCALE_M: Final = 0.15
_ICP_STEPS: Final = 8
_ICP_DONE_M: Final = 0.01
_EARLY_STEPS: Final = 2
_HOPELESS: Final = 1.2
"""Ratio to the lowest energy at which a shift is not refined further, after as many ICP steps."""

_DISTANCE_PENALTY_PER_M: Final = 0.004


class Reference(NamedTuple):
    """An earlier frame in the form that registration needs.

    Attributes:
        grid: Its points, for nearest neighbours.
        occupancy: Its points, for the coarse search.
        age_s: Its age, seconds.
    """

    grid: PointGrid
    occupancy: Occupancy
    age_s: float


def build_reference(points_m: Points, centre_m: NDArray[np.floating], age_s: float) -> Reference:
    """Build the reference of an earlier frame.

    Args:
        points_m: (N, 3) its voxel centroids off the ground, odom space.
        centre_m: (3,) place of its sensor, odom space.
        age_s: Time from it to the frame to register, seconds.
    """
    return reference_to(build_grid(points_m, centre_m), centre_m, age_s)


@step("references")
def reference_to(grid: PointGrid, centre_m: NDArray[np.floating], age_s: float) -> Reference:
    """Build a reference from the kept grid of its points; the cells are marked again.

    The cells take 5 MB per frame, and 1.5 ms.
    """
    return Reference(grid, build_occupancy(grid.points_m, centre_m), age_s)


@compiled
def energy_of(
    grid: PointGrid,
    points: Points,
    sx: float,
    sy: float,
    sz: float,
    rows: NDArray[np.int32],
    enough: float = np.inf,
) -> float:
    """Return the mean nearest distance after a shift, and keep the nearest rows for the next one.

    Once the result cannot be less than `enough`, a lower bound is returned, and not all of `rows`
    is up to date.
    """
    total, most = 0.0, enough * len(points)
    for i in range(len(points)):
        squared, rows[i] = _near(
            grid,
            points[i, 0] + sx,
            points[i, 1] + sy,
            points[i, 2] + sz,
            ENERGY_REACH_M,
            rows[i],
        )
        total += np.sqrt(squared)
        if total >= most:
            break
    return total / len(points)


@inlined
def _near(
    grid: PointGrid, x: float, y: float, z: float, reach: float, row: int
) -> tuple[float, int]:
    """Find the nearest point within reach, given the nearest row of a close place, -1 for none."""
    best, found = reach * reach, -1
    if row >= 0:
        nearest = grid.points_m
        dx, dy, dz = nearest[row, 0] - x, nearest[row, 1] - y, nearest[row, 2] - z
        squared = dx * dx + dy * dy + dz * dz
        if squared < best:
            best, found = squared, row
    return nearer(grid, x, y, z, best, found)


@compiled
def refine(
    grid: PointGrid,
    points: Points,
    shift: NDArray[np.float64],
    rows: NDArray[np.int32],
    steps: int,
) -> bool:
    """Run translation-only ICP with weights 1 / (1 + (d / 0.15)²); True if it has not converged."""
    for _ in range(steps):
        mx, my, mz, total = 0.0, 0.0, 0.0, 0.0
        for i in range(len(points)):
            x, y, z = points[i, 0] + shift[0], points[i, 1] + shift[1], points[i, 2] + shift[2]
            squared, j = _near(grid, x, y, z, _ICP_REACH_M, rows[i])
            rows[i] = j
            if j < 0:
                continue
            weight = 1.0 / (1.0 + squared / (_ICP_SCALE_M * _ICP_SCALE_M))
            mx += weight * (grid.points_m[j, 0] - x)
            my += weight * (grid.points_m[j, 1] - y)
            mz += weight * (grid.points_m[j, 2] - z)
            total += weight
        if total == 0.0:
            return False
        mx, my, mz = mx / total, my / total, mz / total
        shift[0] += mx
        shift[1] += my
        shift[2] += mz
        if mx * mx + my * my + mz * mz < _ICP_DONE_M * _ICP_DONE_M:
            return False
    return True


@compiled
def search(
    reference: Reference,
    points: Points,
    centre: NDArray[np.float64],
    window: float,
    keep: int,
    best: NDArray[np.float64],
) -> None:
    """Find the best shift within a square window: a coarse score, then ICP on the best few.

    `best` is the best shift so far and its energy, and is improved in place.
    """
    occupancy, grid = reference.occupancy, reference.grid
    # cells are twice as coarse as voxels: a third of the points gives the same score
    few = points[:: max(1, len(points) // _COARSE_SAMPLES)]
    cells = cells_of(occupancy, few)
    reach = int(np.ceil(window / CELL_M))
    cx, cy = int(np.round(centre[0] / CELL_M)), int(np.round(centre[1] / CELL_M))
    score = scores_around(occupancy, cells, cx, cy, reach)
    side = 2 * reach + 1
    for i in range(side):
        for j in range(side):
            dx, dy = cx + i - reach, cy + j - reach
            away = CELL_M * np.sqrt(float(dx * dx + dy * dy))
            score[i, j] -= _DISTANCE_PENALTY_PER_M * away
    shift = np.empty(3, np.float64)
    rows, few_rows = np.empty(len(points), np.int32), np.empty(len(few), np.int32)
    lowest = ENERGY_REACH_M
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
        few_rows[:] = -1
        more = refine(grid, few, shift, few_rows, _EARLY_STEPS)
        limit = _HOPELESS * lowest
        early = energy_of(grid, few, shift[0], shift[1], shift[2], few_rows, limit)
        if early >= limit:
            continue
        lowest = min(lowest, early)
        rows[:] = -1
        if len(few) == len(points):
            rows[:] = few_rows
        if more or len(few) < len(points):
            refine(grid, points, shift, rows, _ICP_STEPS - _EARLY_STEPS)
        energy = energy_of(grid, points, shift[0], shift[1], shift[2], rows, best[3])
        if energy < best[3]:
            best[:3] = shift
            best[3] = energy
