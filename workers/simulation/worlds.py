"""Builds a whole street from a seed: roads, ground, the ego's drive, scenery, traffic, weather."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

import numpy as np

from workers.simulation.builder import Network
from workers.simulation.drive import (
    Drive,
    Knots,
    Road,
    drive_along,
    drive_with_care,
    turning_route,
)
from workers.simulation.furniture import junction_furniture
from workers.simulation.meshes import Floats
from workers.simulation.places import PLACES, Place, PlaceName
from workers.simulation.road_map import RoadMap
from workers.simulation.scenery import build_scenery, bump_meshes
from workers.simulation.street import Street
from workers.simulation.terrain import ROAD_WAVES, Terrain, hills
from workers.simulation.traffic import Traffic
from workers.simulation.weather import Weather

EgoStyle = Literal["stands", "drives", "stops_and_goes", "turns"]
EGO_STYLES: Final[tuple[EgoStyle, ...]] = ("stands", "drives", "stops_and_goes", "turns")

Hardship = Literal["dense traffic", "vegetation", "turns", "bumps"]
HARDSHIPS: Final[tuple[Hardship, ...]] = ("dense traffic", "vegetation", "turns", "bumps")

_BEYOND_M: Final = 130.0
"""Street before and after the drive: farther than the lidar sees."""

_ASIDE_M: Final = 85.0
"""How far streets over the main one are built along."""

_FAR_M: Final = 420.0
"""How far lanes go on where traffic comes from, built along or not."""


@dataclass(frozen=True, slots=True)
class StreetPlan:
    """What a street is to be like; all else is drawn from its seed.

    Attributes:
        place: Kind of street.
        style: How the ego drives; None lets the seed choose.
        hard: What makes it hard, if anything.
        steep: Steepest grade.
        rain_share: Beams answered by drops.
        dust: Whether vehicles and wind raise dust.
        unsettling: Whether much moves that is easily taken for standing.
    """

    place: PlaceName = "town"
    style: EgoStyle | None = None
    hard: tuple[Hardship, ...] = ()
    steep: float = 0.01
    rain_share: float = 0.0
    dust: bool = False
    unsettling: bool = False


def draw_plan(rng: np.random.Generator, *, hard: bool) -> StreetPlan:
    """Draw what a street of a fleet is like.

    Args:
        rng: Decides.
        hard: Whether two of `HARDSHIPS` or more make it so.
    """
    places: list[PlaceName] = ["town", "suburb", "highway", "country"]
    place = places[int(rng.choice(4, p=[0.4, 0.25, 0.2, 0.15]))]
    style = EGO_STYLES[int(rng.choice(4, p=[0.2, 0.4, 0.25, 0.15]))]
    chosen: tuple[Hardship, ...] = ()
    if hard:
        possible = [
            h for h in HARDSHIPS if place != "highway" or h in ("dense traffic", "vegetation")
        ]
        count = min(int(rng.integers(2, 4)), len(possible))
        picked = sorted(rng.choice(len(possible), count, replace=False).tolist())
        chosen = tuple(possible[k] for k in picked)
    if "turns" in chosen:
        style = "turns"
    elif place == "highway" or style == "turns":
        style = "drives"
    return StreetPlan(
        place=place,
        style=style,
        hard=chosen,
        steep=float(rng.uniform(0.02, 0.07)) if "bumps" in chosen else float(rng.uniform(0, 0.03)),
        rain_share=float(rng.uniform(0.002, 0.02)) if rng.random() < 0.12 else 0.0,
        dust=bool(rng.random() < 0.12),
    )


def build_street(
    seed: int, *, seconds: float, style: EgoStyle | None = None, plan: StreetPlan | None = None
) -> Street:
    """Build a street that depends on its arguments alone.

    Args:
        seed: Seed of everything in it.
        seconds: How long the log lasts.
        style: How the ego drives; None leaves it to the plan, or to the seed.
        plan: What the street is like; a town without hardships when None.
    """
    plan = plan or StreetPlan()
    rng = np.random.default_rng([seed, 0x57EE7])
    place = PLACES[plan.place]
    chosen = style or plan.style or EGO_STYLES[int(rng.integers(3))]
    least, most = place.cruise_m_per_s
    cruise = float(rng.uniform(least, least + 0.6 * (most - least)))
    way_m = cruise * seconds
    fast = place.name in ("highway", "country")
    swing = float(rng.uniform(0.05, 0.15)) if fast else float(rng.uniform(0.1, 0.35))
    main = Road.bending(
        from_m=-_BEYOND_M - _FAR_M,
        to_m=way_m + _BEYOND_M + _FAR_M,
        swing_rad=swing,
        wave_m=float(rng.uniform(220.0, 400.0)) * (2.0 if fast else 1.0),
    )
    crossings = _crossings(main, place, way_m, rng)
    low, high = -_BEYOND_M, way_m + _BEYOND_M
    terrain = _terrain(plan, main, place, [j for j, _, _ in crossings], way_m, rng)
    ego, leaders = _ego(chosen, main, place, crossings, cruise, seconds, terrain, rng)

    network = Network(
        ((main, place, low, high), *((r, p, -_ASIDE_M, _ASIDE_M) for _, r, p in crossings)), terrain
    )
    green = 3.0 if "vegetation" in plan.hard else 1.0
    fixed = [*build_scenery(network, green=green, rng=rng), *bump_meshes(terrain)]
    if place.name == "town":
        fixed += junction_furniture(network, 0, [j for j, _, _ in crossings], rng)
    traffic = Traffic(
        main=main,
        place=place,
        crossings=crossings,
        ego=ego,
        seconds=seconds,
        dense=2.2 if "dense traffic" in plan.hard else 1.0,
        rng=rng,
    )
    for leader in leaders:
        traffic.offer_companion(leader)
    traffic.park(low, high)
    if plan.unsettling:
        traffic.unsettle()
    traffic.move()
    bounds = (
        float(ego.x_m.min()) - 130.0,
        float(ego.y_m.min()) - 130.0,
        float(ego.x_m.max()) + 130.0,
        float(ego.y_m.max()) + 130.0,
    )
    roads = [(main, place.kerb_m), *((road, p.kerb_m) for _, road, p in crossings)]
    return Street.of(
        seed=seed,
        seconds=seconds,
        ego=ego,
        actors=traffic.actors,
        fixed=fixed,
        terrain=terrain,
        road_map=RoadMap.of(roads, bounds, place.marks_m),
        weather=_weather(plan, ego, terrain, seconds, rng),
        place=place.name,
        hard=plan.hard,
    )


def _crossings(
    main: Road, place: Place, way_m: float, rng: np.random.Generator
) -> list[tuple[float, Road, Place]]:
    """Lay streets over the main one."""
    if place.block_m == 0.0:
        return []
    at = float(rng.uniform(22.0, 45.0))
    at -= place.block_m * np.floor((at + _BEYOND_M - 25.0) / place.block_m)
    crossings = []
    while at < way_m + _BEYOND_M - 25.0:
        other = PLACES["suburb"] if place.name == "suburb" or rng.random() < 0.5 else PLACES["town"]
        if place.name == "country":
            other = PLACES["country"]
        crossings.append((at, main.crossing(at, half_m=260.0), other))
        at += place.block_m
    return crossings


def _terrain(
    plan: StreetPlan,
    main: Road,
    place: Place,
    junctions_m: list[float],
    way_m: float,
    rng: np.random.Generator,
) -> Terrain:
    slopes = hills(rng, steep=plan.steep)
    bumps: list[tuple[float, float, float, float, float]] = []
    if "bumps" in plan.hard and place.name != "highway":
        at = float(rng.uniform(8.0, 18.0))
        while at < way_m + 60.0:
            if all(abs(at - j) > 14.0 for j in junctions_m):
                x, y, heading = (float(v) for v in main.place(at, 0.0))
                half = min(place.kerb_m, 5.5) - 0.1
                bumps.append((x, y, heading, half, float(rng.uniform(0.06, 0.12))))
            at += float(rng.uniform(18.0, 40.0))
    return Terrain(slopes, ROAD_WAVES, np.array(bumps).reshape(-1, 5))


def _ego(
    style: EgoStyle,
    main: Road,
    place: Place,
    crossings: list[tuple[float, Road, Place]],
    cruise: float,
    seconds: float,
    terrain: Terrain,
    rng: np.random.Generator,
) -> tuple[Drive, list[Drive]]:
    """Drive the ego, and find the drives of who goes before and behind."""
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
    """Lay the ego's way into a crossing street; give it and where the ego begins on it."""
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


def travelled_m(speed: Knots) -> float:
    """Give the way of a drive of these speeds."""
    return sum((b[0] - a[0]) * (a[1] + b[1]) / 2 for a, b in pairwise(speed))


def _weather(
    plan: StreetPlan, ego: Drive, terrain: Terrain, seconds: float, rng: np.random.Generator
) -> Weather:
    puffs: Floats = np.zeros((0, 6))
    if plan.dust:
        rows = []
        for _ in range(max(int(seconds / 2.0), 1)):
            at = float(rng.uniform(-1.0, seconds))
            x, y, yaw = ego.pose(at + 1.0)
            ahead, aside = float(rng.uniform(5.0, 30.0)), float(rng.normal(0.0, 6.0))
            px = x + np.cos(yaw) * ahead - np.sin(yaw) * aside
            py = y + np.sin(yaw) * ahead + np.cos(yaw) * aside
            z = float(terrain.slope_m(px, py)) + 0.6
            rows.append((px, py, z, float(rng.uniform(0.6, 1.6)), at, at + rng.uniform(1.0, 2.5)))
        puffs = np.array(rows)
    return Weather(plan.rain_share, puffs, stray_share=2e-5)
