"""Builds a whole street from a seed: the road, the ego's drive, scenery and traffic."""

from itertools import pairwise
from typing import Final, Literal

import numpy as np

from workers.simulation.drive import Road, drive_along
from workers.simulation.scenery import build_scenery
from workers.simulation.street import Street
from workers.simulation.traffic import EGO_LANE_M, moving_traffic, parked_cars

EgoStyle = Literal["stands", "drives", "stops_and_goes"]
EGO_STYLES: Final[tuple[EgoStyle, ...]] = ("stands", "drives", "stops_and_goes")

_BEYOND_M: Final = 130.0
"""Street before and after the drive: farther than the lidar sees."""

_BLOCK_M: Final = 95.0


def build_street(seed: int, *, seconds: float, style: EgoStyle | None = None) -> Street:
    """Build a street that depends on the seed alone.

    Args:
        seed: Seed of everything in it.
        seconds: How long the log lasts.
        style: How the ego drives; None lets the seed choose.
    """
    rng = np.random.default_rng([seed, 0x57EE7])
    chosen = style or EGO_STYLES[int(rng.integers(len(EGO_STYLES)))]
    speed = _ego_speed(chosen, seconds, rng)
    travelled_m = sum((b[0] - a[0]) * (a[1] + b[1]) / 2 for a, b in pairwise(speed))
    from_m, to_m = -_BEYOND_M, travelled_m + _BEYOND_M
    road = Road.bending(
        from_m=from_m
        - 2 * _BEYOND_M
        - 15.0 * seconds,  # where oncoming traffic comes from and goes
        to_m=to_m + 2 * _BEYOND_M + 15.0 * seconds,
        swing_rad=float(rng.uniform(0.1, 0.35)),
        wave_m=float(rng.uniform(220.0, 400.0)),
    )
    ego = drive_along(
        road, from_m=0.0, across_m=EGO_LANE_M, speed=speed, seconds=seconds, backwards=False
    )
    first = float(rng.uniform(22.0, 45.0))
    junctions_m = [j for j in np.arange(first - 3 * _BLOCK_M, to_m, _BLOCK_M) if from_m + 20 < j]
    junctions_m = [j for j in junctions_m if j < to_m - 20]
    fixed = build_scenery(road, from_m=from_m, to_m=to_m, junctions_m=junctions_m, rng=rng)
    parked = parked_cars(road, from_m=from_m, to_m=to_m, junctions_m=junctions_m, rng=rng)
    moving = moving_traffic(
        road, ego=ego, ego_speed=speed, seconds=seconds, junctions_m=junctions_m, rng=rng
    )
    return Street.of(seed=seed, seconds=seconds, ego=ego, actors=[*moving, *parked], fixed=fixed)


def _ego_speed(
    style: EgoStyle, seconds: float, rng: np.random.Generator
) -> list[tuple[float, float]]:
    cruise = float(rng.uniform(5.0, 9.0))
    if style == "drives":
        return [(0.0, cruise), (seconds + 2.0, cruise)]
    if style == "stands":
        leaves_s = 0.55 * seconds
        return [(0.0, 0.0), (leaves_s, 0.0), (leaves_s + 4.0, cruise), (seconds + 6.0, cruise)]
    knots: list[tuple[float, float]] = [(0.0, cruise)]
    while knots[-1][0] < seconds + 2.0:
        t = knots[-1][0] + float(rng.uniform(3.0, 6.0))
        knots += [(t, cruise), (t + 2.5, 0.0), (t + 5.0, 0.0), (t + 8.0, cruise)]
    return knots
