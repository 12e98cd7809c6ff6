"""Pose consistency: a frame must fit those before it, since most of a street is static."""

from collections import deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from workers.lidar.motion_limits import MAX_ACCELERATION_M_PER_S2, POSE_NOISE_M
from workers.lidar.registration_check import extract_structure, register_structures
from workers.points.neighbours import nearest_distances
from workers.points.point_kernels import within
from workers.selfsupervised.registration import Reference

SHARE: Final = 0.75
"""Share of the nearby points that must fit.

A side that slides along itself fits at any pose error, so two thirds miss half a metre along a real
street. Movers seldom take a quarter of the nearby points, and most of a long side overlaps itself a
tenth of a second later."""

NEAR_M: Final = 40.0
"""Range up to which points are compared, metres; beyond it the distance to a neighbour measures
only the spacing of the beams."""

FLOOR_M: Final = 0.15
"""Misfit that counts as a fit in any log, metres.

It is half a voxel (0.075 m), range noise (0.03 m) and a pose error of 3 cm. On real logs 0.3
degrees of yaw, or a step of 0.2 m, exceed it; noise of 0.1 degrees per frame does not."""

JUMP: Final = 2.0

_REACH_M: Final = 1.0
_SAMPLES: Final = 1000
_FEWEST: Final = _SAMPLES
"""Points needed for a comparison.

With fewer, the distance to a neighbour measures the spacing of the beams. A car that starts to
drive changes that spacing as much as a wrong pose does."""

_REMEMBERED: Final = 10


class PoseConsistency:
    """Compares the fit of a frame with the usual fit of this log's frames.

    The usual fit depends on the spacing of the beams and the speed of the car, so it is learned. A
    frame with twice the misfit of the last second is suspect: with a wrong pose everything in it
    would seem to move. But streets change too, and a train at speed sees other objects in every
    frame. A wrong pose is one that another pose would improve. A suspect frame therefore fits if a
    second registration does not move it and the car keeps its velocity.
    """

    def __init__(self) -> None:
        self._usual_m: dict[str, deque[float]] = {
            name: deque(maxlen=_REMEMBERED) for name in ("near", "far")
        }

    def problem(
        self,
        points_m: Points,
        centre_m: NDArray[np.floating],
        *,
        near: tuple[Reference, Mask],
        far: tuple[Reference, Mask],
        expected_m: NDArray[np.floating] | None,
    ) -> str:
        """Return why a frame cannot be compared with two earlier ones; empty when it can.

        Args:
            points_m: (V, 3) voxel centroids off the ground, odom space.
            centre_m: (3,) place of the sensor, odom space.
            near: The frame about 0.1 s ago, and (V,) places at which it has evidence.
            far: The same of the frame about 0.5 s ago.
            expected_m: (3,) place of the sensor at constant velocity; None if unknown.
        """
        stray_m = MAX_ACCELERATION_M_PER_S2 * near[0].age_s ** 2 + POSE_NOISE_M
        goes_on = expected_m is not None and np.linalg.norm(centre_m - expected_m) < stray_m
        close = within(points_m - centre_m.astype(np.float32), 0.0, NEAR_M)
        found_m: dict[str, float] = {}
        for name, (past, known) in (("near", near), ("far", far)):
            asked = points_m[close & known]
            if len(asked) < _FEWEST:
                continue
            usual_m = self._usual_m[name]
            found_m[name] = misfit_m(asked, past)
            typical_m = float(np.median(usual_m)) if usual_m else found_m[name]
            suspect = found_m[name] > max(FLOOR_M, JUMP * typical_m)
            if suspect and not (goes_on and is_stable(points_m, centre_m, past)):
                return (
                    f"does not fit the frame {past.age_s:.1f} s ago: a quarter of what is near "
                    f"is more than {found_m[name]:.2f} m off, {typical_m:.2f} m is usual"
                )
        for name, value in found_m.items():
            self._usual_m[name].append(value)
        return ""


def misfit_m(points_m: Points, past: Reference) -> float:
    """Return the distance to an earlier frame within which three quarters of the points lie.

    Args:
        points_m: (N, 3), of which up to 1000 are compared, evenly spread over their order.
        past: The earlier frame.

    Returns:
        Metres, at most 1.
    """
    step = max(1, -(-len(points_m) // _SAMPLES))
    return float(np.quantile(nearest_distances(past.grid, points_m[::step], _REACH_M), SHARE))


def is_stable(points_m: Points, centre_m: NDArray[np.floating], past: Reference) -> bool:
    """Return True if a second registration moves a frame by less than 0.15 m within 40 m.

    Along a direction without constraints, such as a rail, every frame stays. False where too
    little structure is static.

    Args:
        points_m: (V, 3) voxel centroids off the ground, odom space.
        centre_m: (3,) place of the sensor.
        past: The earlier frame.
    """
    before = extract_structure(past.grid.points_m, centre_m)
    now = extract_structure(points_m, centre_m)
    if before is None or now is None:
        return False
    found = register_structures(before, now)
    return found is not None and max(found.shift_m, NEAR_M * found.turn_rad) < FLOOR_M
