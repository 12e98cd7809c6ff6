"""Whether a frame fits those before it: most of a street stands still, so most of it must."""

from collections import deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from workers.lidar.motion_limits import MAX_ACCELERATION_M_PER_S2, POSE_NOISE_M
from workers.lidar.registration_check import misfit_between, structure_of
from workers.points.neighbours import nearest_distances
from workers.points.point_kernels import within
from workers.selfsupervised.registration import Reference

SHARE: Final = 0.75
"""Of what is near, how much must fit. A side that slides along itself fits whatever the error, so
two thirds miss half a metre along a real street; movers seldom take a quarter of what is near, and
most of a long side lies on itself a tenth of a second later."""

NEAR_M: Final = 40.0
"""Beyond it beams lie so far apart that distances to neighbours tell of them alone."""

FLOOR_M: Final = 0.15
"""Half a voxel (0.075 m), range noise (0.03 m) and a pose error of 3 cm: fits, whatever was before.

0.3 degrees of yaw, or 0.2 m of a step, exceed it on real logs; noise of 0.1 degrees per frame does
not."""

JUMP: Final = 2.0

_REACH_M: Final = 1.0
_SAMPLES: Final = 1000
_FEWEST: Final = _SAMPLES
"""With fewer places the distance to a neighbour tells how far apart the beams are, which a car that
starts to drive changes as much as a wrong pose does: nothing can be told."""

_REMEMBERED: Final = 10


class FitMonitor:
    """Compares how well a frame fits with how well frames of this log usually do.

    What is usual depends on the spacing of the beams and the speed of the car, so it is learned. A
    frame that fits twice as badly as the frames of the last second is under suspicion: with a wrong
    pose everything in it would seem to move. But streets change, too, and between rails at speed
    other things are seen in every frame. A wrong pose is one that another pose would mend: where a
    second registration leaves the frame in its place, and the car goes on as it went, it fits.
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
        """Say why a frame cannot be compared with two earlier ones; empty when it can.

        Args:
            points_m: (V, 3) voxel centroids off the ground, odom space.
            centre_m: (3,) where the sensor is, odom space.
            near: The frame about 0.1 s ago, and (V,) which places it has an opinion on.
            far: The same of the frame about 0.5 s ago.
            expected_m: (3,) where the sensor would be had it gone on as it went; None if unknown.
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
            if suspect and not (goes_on and stays(points_m, centre_m, past)):
                return (
                    f"does not fit the frame {past.age_s:.1f} s ago: a quarter of what is near "
                    f"is more than {found_m[name]:.2f} m off, {typical_m:.2f} m is usual"
                )
        for name, value in found_m.items():
            self._usual_m[name].append(value)
        return ""


def misfit_m(points_m: Points, past: Reference) -> float:
    """Distance to an earlier frame that three quarters of these points keep, metres, at most 1.

    Args:
        points_m: (N, 3) of which up to 1000 are asked, evenly spread over their order.
        past: The earlier frame.
    """
    step = max(1, -(-len(points_m) // _SAMPLES))
    return float(np.quantile(nearest_distances(past.grid, points_m[::step], _REACH_M), SHARE))


def stays(points_m: Points, centre_m: NDArray[np.floating], past: Reference) -> bool:
    """Whether a second registration leaves a frame where it is, all that is near within 0.15 m.

    Along what nothing holds, such as a rail, it leaves any frame; False where too little stands.

    Args:
        points_m: (V, 3) voxel centroids off the ground, odom space.
        centre_m: (3,) where the sensor is.
        past: The earlier frame.
    """
    before = structure_of(past.grid.points_m, centre_m)
    now = structure_of(points_m, centre_m)
    if before is None or now is None:
        return False
    found = misfit_between(before, now)
    return found is not None and max(found.shift_m, NEAR_M * found.turn_rad) < FLOOR_M
