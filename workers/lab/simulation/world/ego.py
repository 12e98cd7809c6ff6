"""Ego drive through a street, and the vehicles ahead of it and behind it."""

import numpy as np

from workers.lab.simulation.world.motion_along_road import (
    Drive,
    Road,
    drive_along,
    drive_with_care,
    turning_route,
)
from workers.lab.simulation.world.street_kinds import Place
from workers.lab.simulation.world.street_plan import EgoStyle
from workers.lab.simulation.world.terrain import Terrain


def drive_ego(
    style: EgoStyle,
    main: Road,
    *,
    place: Place,
    crossings: list[tuple[float, Road, Place]],
    cruise: float,
    seconds: float,
    terrain: Terrain,
    rng: np.random.Generator,
) -> tuple[Drive, list[Drive]]:
    """Drive the ego, and derive the drives of the vehicles ahead and behind.

    Args:
        style: Driving style; a turning ego goes straight on where there is no crossing.
        main: The road it starts on.
        place: Kind of that road.
        crossings: Roads over it, with the path length of the main road where each crosses.
        cruise: Speed where nothing slows it, m/s.
        seconds: Duration.
        terrain: The ground; bumps are taken slowly.
        rng: Random generator of the street.

    Returns:
        Its drive, and those of the others.
    """
    lane = -place.lanes_m[min(1, len(place.lanes_m) - 1) if place.barriers else 0]
    gaps = [float(rng.uniform(12.0, 20.0)), -float(rng.uniform(11.0, 16.0))]
    gaps = [gap * (1.0 + cruise / 20.0) for gap in gaps if rng.random() < 0.75]
    ahead = [c for c in crossings if c[0] > 15.0]
    if style == "turns" and ahead:
        route, start = _turn(main, lane, ahead[0], place, rng)
        slow = [(route.nearest_m(x, y), 4.5) for x, y, *_ in terrain.bumps]

        def careful(gap_m: float) -> Drive:
            return drive_with_care(
                route,
                from_m=start + gap_m,
                across_m=0.0,
                cruise_m_per_s=cruise,
                seconds=seconds,
                slow=slow,
            )

        return careful(0.0), [careful(gap) for gap in gaps]
    speed = _ego_speed(style, cruise, seconds, rng)
    if len(terrain.bumps):
        speed = [(t, min(v, 5.5)) for t, v in speed]

    def along(gap_m: float, ahead_s: float) -> Drive:
        return drive_along(
            main,
            from_m=gap_m,
            across_m=lane,
            speed=[(t - ahead_s, v) for t, v in speed],
            seconds=seconds,
            backwards=False,
        )

    return along(0.0, 0.0), [along(gap, float(np.sign(gap)) * 1.2) for gap in gaps]


def _turn(
    main: Road,
    lane_m: float,
    crossing: tuple[float, Road, Place],
    place: Place,
    rng: np.random.Generator,
) -> tuple[Road, float]:
    """Route the ego into a crossing street; return the route and the ego's start on it."""
    _, road, other = crossing
    first = main.lane(lane_m, backwards=False)
    left = bool(rng.random() < 0.5)
    across = other.lanes_m[0] * (-1 if left else 1)
    second = road.lane(across, backwards=not left)
    x, y, _ = (float(v) for v in road.place(0.0, 0.0))
    leave = first.nearest_m(x, y) - (other.kerb_m + 0.5)
    enter = second.nearest_m(x, y) + (place.kerb_m + 0.5)
    route = turning_route(first, leave, second, enter)
    x, y, _ = (float(v) for v in main.place(0.0, lane_m))
    return route, route.nearest_m(x, y)


def _ego_speed(
    style: EgoStyle, cruise: float, seconds: float, rng: np.random.Generator
) -> list[tuple[float, float]]:
    if style in ("drives", "turns"):
        return [(0.0, cruise), (seconds + 2.0, cruise)]
    if style == "stands":
        leaves_s = 0.55 * seconds
        return [(0.0, 0.0), (leaves_s, 0.0), (leaves_s + 4.0, cruise), (seconds + 6.0, cruise)]
    knots: list[tuple[float, float]] = [(0.0, cruise)]
    while knots[-1][0] < seconds + 2.0:
        t = knots[-1][0] + float(rng.uniform(3.0, 6.0))
        brakes_s = cruise / float(rng.uniform(2.0, 4.5))
        knots += [
            (t, cruise),
            (t + brakes_s, 0.0),
            (t + brakes_s + 2.5, 0.0),
            (t + brakes_s + 2.5 + cruise / 2.2, cruise),
        ]
    return knots
