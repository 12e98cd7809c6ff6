"""Scenery along streets: façades, pavements, fences, guard rails, plants, poles, signs, bumps."""

from typing import Final

import numpy as np

from workers.lab.simulation.models.kinds import Material, StreetClass
from workers.lab.simulation.models.meshes import Mesh, grid
from workers.lab.simulation.models.plants import SORTS, bush, grass, tree
from workers.lab.simulation.world.builder import Builder, Network
from workers.lab.simulation.world.facades import barriers, build_facades, gardens
from workers.lab.simulation.world.furniture import furniture
from workers.lab.simulation.world.terrain import BUMP_HALF_M, Terrain, bump_profile

KERB_HIGH_M: Final = 0.14


def build_scenery(network: Network, *, green: float, rng: np.random.Generator) -> list[Mesh]:
    """Line all roads on both sides.

    Porches and pillars add surfaces that face along the road. Without them, odometry would slip
    along smooth façades.

    Args:
        network: The roads.
        green: Factor of vegetation density; 1 is usual.
        rng: Random generator of the street.
    """
    meshes: list[Mesh] = []
    for number, (_, place, from_m, to_m) in enumerate(network.roads):
        build = Builder(network, number, green, rng)
        for side in (1, -1):
            if place.pavement_m > 0:
                _pavement(build, from_m, to_m, side)
            if place.facade_m > 0:
                build_facades(build, from_m, to_m, side)
            if place.gardens:
                gardens(build, from_m, to_m, side)
            if place.barriers:
                barriers(build, from_m, to_m, side)
            furniture(build, from_m, to_m, side)
            _greenery(build, from_m, to_m, side)
        meshes += build.meshes()
    return meshes


def bump_meshes(terrain: Terrain) -> list[Mesh]:
    """Build the meshes of the terrain's speed bumps."""
    meshes = []
    along = np.linspace(-BUMP_HALF_M, BUMP_HALF_M, 9)
    for x, y, heading, half_width, high in terrain.bumps:
        across = np.linspace(-half_width, half_width, 9)
        a, b = np.meshgrid(along, across, indexing="ij")
        east = x + a * np.cos(heading) - b * np.sin(heading)
        north = y + a * np.sin(heading) + b * np.cos(heading)
        up = terrain.slope_m(east, north) + high * bump_profile(a) + 0.012
        corners = np.stack([east, north, up], axis=-1)
        meshes.append(grid(corners, StreetClass.ROAD, Material.STONE))
    return meshes


def _pavement(build: Builder, from_m: float, to_m: float, side: int) -> None:
    """Build kerb and pavement, interrupted where other roads join."""
    place, step = build.place, 2.0
    along = np.arange(from_m, to_m, step)
    profile = np.array([(0.0, -0.05), (0.02, KERB_HIGH_M), (place.pavement_m, KERB_HIGH_M)])
    across = side * (place.kerb_m + profile[:, 0])
    x, y, _ = build.road.place(
        np.repeat(along[:, None], 3, axis=1), np.broadcast_to(across, (len(along), 3))
    )
    z = build.network.terrain.slope_m(x, y) + profile[:, 1]
    kept = build.network.free_of_roads(
        x[:, 0].copy(), y[:, 0].copy(), beyond_m=0.0, but=build.number
    )
    corners = np.stack([x, y, z], axis=-1)
    for run in np.split(np.arange(len(along)), np.flatnonzero(~kept)):
        stretch = run[kept[run]]
        if len(stretch) > 1:
            build.whole.append(grid(corners[stretch], StreetClass.SIDEWALK, Material.STONE))


def _greenery(build: Builder, from_m: float, to_m: float, side: int) -> None:
    """Plant trees along the kerb, and trees, bushes and grass beyond."""
    place, rng = build.place, build.rng
    length = to_m - from_m
    near = place.kerb_m + (1.2 if place.pavement_m else 3.0)
    for _ in range(round(length / 100.0 * place.trees_per_100_m * build.green)):
        along = float(rng.uniform(from_m, to_m))
        deep = 0.0 if rng.random() < 0.5 else float(rng.uniform(2.0, 22.0))
        if not place.gardens and not place.barriers:
            deep = 0.0
        if build.free(along, side * (near + deep), 1.0):
            size = float(rng.uniform(0.7, 1.5))
            build.put(
                tree(int(rng.integers(SORTS))),
                *(along, side * (near + deep)),
                turned_rad=float(rng.uniform(0.0, 6.3)),
                scale=size,
            )
    wild = (8.0 if place.gardens or place.barriers else 1.5) * build.green
    for _ in range(round(length / 100.0 * wild)):
        along = float(rng.uniform(from_m, to_m))
        across = side * (near + 0.6 + float(rng.uniform(0.0, 14.0 if place.gardens else 6.0)))
        if build.free(along, across, 1.0):
            size = float(rng.uniform(0.6, 1.5))
            build.put(
                bush(int(rng.integers(SORTS))),
                *(along, across),
                turned_rad=float(rng.uniform(0.0, 6.3)),
                scale=size,
            )
            if place.pavement_m < 5.0:
                build.put(grass(int(rng.integers(SORTS))), along + 3.0, across)
