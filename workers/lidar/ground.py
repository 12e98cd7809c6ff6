"""Ground removal with Patchwork++, and a height guard that keeps the sides of near cars."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from workers.points.compiled import compiled
from workers.points.step_names import step

GUARD_M = 0.5
GUARD_PER_M = 0.04
"""Height guard: largest height of ground over the plane under the car, metres, and its slope.

It allows a kerb and a 4 % slope. A car at 4 to 6 m hides the road near the sensor, and without the
guard a plane would be fitted to the car."""


@step("ground")
def ground_mask(points_m: Points, *, sensor_height_m: float) -> Mask:
    """Find the ground points: Patchwork++ (Lee, Lim, Myung, IROS 2022), and the height guard.

    Patchwork++ adapts its thresholds from frame to frame. A new instance per frame is as accurate
    on real logs and better on very even roads. Its masks are the same wherever a log is cut into
    shards.

    Args:
        points_m: (N, 3) valid points about the sensor, z up, metres.
        sensor_height_m: Height of the sensor over the road.

    Returns:
        (N,) bool.
    """
    import pypatchworkpp

    mask = np.zeros(len(points_m), np.bool_)
    if len(points_m) == 0:
        return mask
    parameters = pypatchworkpp.Parameters()
    for name, value in _parameters(sensor_height_m).items():
        setattr(parameters, name, value)
    with _silent_native_stdout():
        patchwork = pypatchworkpp.patchworkpp(parameters)
    # the library also expects an intensity
    cloud = np.zeros((len(points_m), 4), np.float32)
    cloud[:, :3] = points_m
    patchwork.estimateGround(cloud)
    _mark_low(points_m, np.asarray(patchwork.getGroundIndices()), sensor_height_m, mask)
    return mask


@compiled
def _mark_low(points: Points, found: NDArray[np.integer], sensor_height: float, mask: Mask) -> None:
    """Mark the ground points found by Patchwork++ that pass the height guard."""
    for i in found:
        x, y = points[i, 0], points[i, 1]
        across = np.sqrt(x * x + y * y)
        mask[i] = points[i, 2] < -sensor_height + GUARD_M + GUARD_PER_M * across


def _parameters(sensor_height_m: float) -> dict[str, object]:
    """Return every field: some are uninitialised memory (`intensity_thr` was 3.9e180)."""
    return {
        "verbose": False,
        "sensor_height": sensor_height_m,
        "min_range": 2.0,
        "max_range": 80.0,
        # 0.125 by default: took 8 % of the moving points with the road
        "th_dist": 0.08,
        "th_seeds": 0.125,
        "th_dist_v": 0.1,
        "th_seeds_v": 0.25,
        "num_iter": 3,
        "num_lpr": 20,
        "num_min_pts": 10,
        "uprightness_thr": 0.707,
        "adaptive_seed_selection_margin": -1.2,
        "num_zones": 4,
        "num_rings_each_zone": [2, 4, 4, 4],
        "num_sectors_each_zone": [16, 32, 54, 32],
        "num_rings_of_interest": 4,
        "elevation_thr": [0.0, 0.0, 0.0, 0.0],
        "flatness_thr": [0.0, 0.0, 0.0, 0.0],
        "max_elevation_storage": 1000,
        "max_flatness_storage": 1000,
        "enable_RVPF": True,
        "enable_TGR": True,
        # removes reflections by intensity, whose scale is not known for every sensor
        "enable_RNR": False,
        "RNR_ver_angle_thr": -15.0,
        "RNR_intensity_thr": 0.2,
        "intensity_thr": 0.2,
    }


@contextmanager
def _silent_native_stdout() -> Iterator[None]:
    """Discard native output on stdout, which is for results; the library prints a greeting."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
