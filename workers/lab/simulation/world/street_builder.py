"""Street builder: builds roads, ground, ego drive, scenery, traffic and weather from a seed."""

from typing import Final

import numpy as np

from workers.lab.simulation.models.meshes import Floats
from workers.lab.simulation.world.builder import Network
from workers.lab.simulation.world.ego import drive_ego
from workers.lab.simulation.world.furniture import junction_furniture
from workers.lab.simulation.world.motion_along_road import Drive, Road
from workers.lab.simulation.world.road_map import RoadMap
from workers.lab.simulation.world.scenery import build_scenery, bump_meshes
from workers.lab.simulation.world.slow_lorries import add_slow_lorries
from workers.lab.simulation.world.street import Street
from workers.lab.simulation.world.street_kinds import PLACES, Place
from workers.lab.simulation.world.street_plan import EGO_STYLES, EgoStyle, StreetPlan
from workers.lab.simulation.world.terrain import ROAD_WAVES, Terrain, hills
from workers.lab.simulation.world.traffic import Traffic
from workers.lab.simulation.world.weather import Weather

_BEYOND_M: Final = 130.0
"""Length of street before and after the drive, metres: more than the lidar's range."""

_ASIDE_M: Final = 85.0
"""Half length of crossing streets with scenery, metres."""

_FAR_M: Final = 420.0
"""Length of lanes beyond the scenery, from which traffic comes, metres."""


def build_street(
    seed: int, *, seconds: float, style: EgoStyle | None = None, plan: StreetPlan | None = None
) -> Street:
    """Build a street that depends on its arguments alone.

    Args:
        seed: Seed of everything in it.
        seconds: Duration of the log.
        style: Driving style of the ego; None leaves it to the plan, or to the seed.
        plan: Plan of the street; a town without hardships when None.
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
    ego, leaders = drive_ego(
        chosen,
        main,
        place=place,
        crossings=crossings,
        cruise=cruise,
        seconds=seconds,
        terrain=terrain,
        rng=rng,
    )

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
        without=plan.without,
    )
    for leader in leaders:
        traffic.offer_companion(leader)
    if plan.slow_lorries:
        add_slow_lorries(traffic)
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
    """Build the streets that cross the main one."""
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
