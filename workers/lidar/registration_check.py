"""Registration check: point-to-plane registration of static structure, against the odometry.

It uses neither the odometry's map nor its motion model: only two frames and their static structure.
Along directions without constraints (a tunnel, an empty motorway) it has no result.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points, Transform
from workers.points.compiled import compiled
from workers.points.neighbours import PointGrid, build_grid, nearest_few, nearest_rows

NEAR_M: Final = 40.0
"""Range of the structure, metres; beyond it beams are too far apart for planes."""

FEWEST: Final = 150
_SAMPLES: Final = 800
_AROUND: Final = 8
_FLAT: Final = 0.05
"""Ratio of the least to the middle spread of a neighbourhood; a leaf or a corner is no plane."""

_STEPS: Final = 8
_REACH_M: Final = 1.2
_CLOSEST_REACH_M: Final = 0.35
_WIDEST_M: Final = 0.4
"""Residuals that count in the first step, metres, halved in each further one.

Most cars that move have larger ones."""

_LEAST_M: Final = 0.03
"""Noise of the sensor, metres: the smallest scale of the robust weights."""

_MOST: Final = 0.9
_CONVERGED: Final = 2e-3
_CONSTRAINED: Final = 0.02
"""Ratio of the information along a direction to the best one, below which it is unconstrained."""


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """Static structure around the sensor in one frame.

    Attributes:
        centre_m: (3,) place of the sensor, odom space.
        grid: All of its points.
        sample_m: (S, 3) a sample of them, on planes.
        normals: (S, 3) of those planes.
    """

    centre_m: NDArray[np.float64]
    grid: PointGrid
    sample_m: NDArray[np.float64]
    normals: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """Correction of one frame that makes it fit another.

    Attributes:
        shift_m: Over the ground, at the sensor.
        turn_rad: About the vertical axis.
        tilt_rad: About horizontal axes. Walls hardly constrain it, and the few planes that do,
            leaves and eaves, are sampled by other beams in every frame.
        before_m: Residual to planes that nine in ten points keep, at the odometry's pose.
        after_m: The same after the correction.
        share: Share of the sample with a counterpart.
        correction: (4, 4) motion over the ground, odom space, without tilt and heave.
    """

    shift_m: float
    turn_rad: float
    tilt_rad: float
    before_m: float
    after_m: float
    share: float
    correction: Transform


def extract_structure(static_m: Points, centre_m: NDArray[np.floating]) -> Structure | None:
    """Extract the structure of a frame from its static places; None where there are too few.

    Args:
        static_m: (N, 3) places off the ground that no stream labels dynamic, odom space.
        centre_m: (3,) place of the sensor.
    """
    centre = np.asarray(centre_m, np.float64)
    near = _near(static_m, centre[0], centre[1])
    if len(near) < FEWEST:
        return None
    grid = build_grid(near, centre)
    sample = np.ascontiguousarray(near[:: max(1, len(near) // _SAMPLES)])
    around = grid.points_m[nearest_few(grid, sample, _AROUND)].astype(np.float64)
    spread = around - around.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("ski,skj->sij", spread, spread))
    flat = values[:, 0] < _FLAT * np.maximum(values[:, 1], 1e-9)
    if int(flat.sum()) < FEWEST // 2:
        return None
    return Structure(centre, grid, sample[flat].astype(np.float64), vectors[flat, :, 0])


def register_structures(reference: Structure, moved: Structure) -> Misfit | None:
    """Register one frame to another, starting at the odometry's poses; None if it cannot.

    Args:
        reference: The earlier frame.
        moved: The later one; its planes are matched.
    """
    rotation, shift = np.eye(3), np.zeros(3)
    arms, normals = moved.sample_m - moved.centre_m, moved.normals
    reach_m, before_m, after_m, share = _REACH_M, np.nan, np.nan, 0.0
    for count in range(_STEPS):
        turned = arms @ rotation.T
        placed = turned + moved.centre_m + shift
        row = nearest_rows(reference.grid, placed, reach_m)
        met = row >= 0
        share = float(met.mean())
        if int(met.sum()) < FEWEST // 2:
            return None
        planes = normals[met] @ rotation.T
        gap_m = ((reference.grid.points_m[row[met]] - placed[met]) * planes).sum(axis=1)
        size_m = np.abs(gap_m)
        after_m = float(np.quantile(size_m, _MOST))
        before_m = after_m if np.isnan(before_m) else before_m
        usual_m = 2.0 * float(np.median(size_m))
        tolerated_m = max(_WIDEST_M * 0.5**count, usual_m, _LEAST_M)
        step = _step(turned[met], planes, gap_m, tolerated_m)
        rotation = _rotation(step[:3]) @ rotation
        shift = shift + step[3:]
        reach_m = max(_CLOSEST_REACH_M, 0.7 * reach_m)
        if float(np.linalg.norm(step[3:])) + 10 * float(np.linalg.norm(step[:3])) < _CONVERGED:
            break
    turn_rad = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
    upright, level = _rotation(np.array([0.0, 0.0, turn_rad])), np.array([shift[0], shift[1], 0.0])
    correction: Transform = np.eye(4)
    correction[:3, :3] = upright
    correction[:3, 3] = moved.centre_m + level - upright @ moved.centre_m
    return Misfit(
        shift_m=float(np.linalg.norm(level)),
        turn_rad=abs(turn_rad),
        tilt_rad=float(np.hypot(rotation[2, 0], rotation[2, 1])),
        before_m=before_m,
        after_m=after_m,
        share=share,
        correction=correction,
    )


@compiled
def _near(points: Points, x: float, y: float) -> Points:
    """Select points near a place, seen from above; (M, 3)."""
    rows = np.empty(points.shape, np.float32)
    count = 0
    for i in range(len(points)):
        dx, dy = np.float64(points[i, 0]) - x, np.float64(points[i, 1]) - y
        if dx * dx + dy * dy < NEAR_M**2:
            rows[count] = points[i]
            count += 1
    return rows[:count].copy()


def _step(
    arms: NDArray[np.float64],
    planes: NDArray[np.float64],
    gap_m: NDArray[np.float64],
    tolerated_m: float,
) -> NDArray[np.float64]:
    """Compute a robust Gauss-Newton step, (6,) rotation then shift, in constrained directions."""
    weight = 1.0 / (1.0 + (gap_m / tolerated_m) ** 2)
    lever_m = 10.0
    jacobian = np.hstack([np.cross(arms, planes) / lever_m, planes])
    # sums in one order, at any number of BLAS threads
    information = np.einsum("ni,nj->ij", weight[:, None] * jacobian, jacobian)
    values, vectors = np.linalg.eigh(information)
    constrained = values > _CONSTRAINED * values[-1]
    right = vectors.T @ np.einsum("ni,n->i", jacobian, weight * gap_m)
    step: NDArray[np.float64] = vectors[:, constrained] @ (right[constrained] / values[constrained])
    step[:3] /= lever_m
    return step


def _rotation(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrix of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: NDArray[np.float64] = (
        np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
    )
    return turned
