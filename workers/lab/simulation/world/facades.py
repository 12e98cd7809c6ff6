"""Façades and other street boundaries: houses, garden fences, guard rails, noise walls."""

from functools import cache
from typing import Final

import numpy as np

from workers.lab.simulation.models.kinds import Material, StreetClass
from workers.lab.simulation.models.meshes import Mesh, box, limb
from workers.lab.simulation.models.plants import SORTS, hedge
from workers.lab.simulation.world.builder import Builder
from workers.lab.simulation.world.street_kinds import Place

_NARROW_M: Final = 5.0
"""Sampling step for clearance tests, metres: less than the width of the narrowest carriageway."""


def build_facades(build: Builder, from_m: float, to_m: float, side: int) -> None:
    """Place houses in a row, or apart where there are gardens."""
    place, rng, at = build.place, build.rng, from_m
    rural = place.name == "country"
    while at < to_m - 3.0:
        length, depth = float(rng.uniform(7.0, 18.0)), float(rng.uniform(8.0, 14.0))
        high = float(rng.uniform(4.0, 8.0) if place.gardens else rng.uniform(5.0, 18.0))
        back = float(rng.choice([0.0, 0.0, 0.6, 1.5, 3.0])) * (2.0 if place.gardens else 1.0)
        front = place.facade_m + back
        if _is_free(build, (at, at + length), (front, front + depth), side):
            middle = at + length / 2
            build.put(
                _house(length, depth, high, pointed=place.gardens),
                *(middle, side * (front + depth / 2)),
                sunk_m=1.5,
            )
            _relief(build, at, length, side * front, high)
        gap = rng.choice([0.0, 0.0, 3.0])
        if place.gardens:
            gap = rng.uniform(40.0, 120.0) if rural else rng.uniform(4.0, 14.0)
        at += length + float(gap)


def _is_free(
    build: Builder, along_m: tuple[float, float], across_m: tuple[float, float], side: int
) -> bool:
    """Test that no other road lies under a house; a road may be narrower than the house is long."""
    along, across = (
        np.linspace(*each, 2 + int((each[1] - each[0]) / _NARROW_M)) for each in (along_m, across_m)
    )
    return all(build.free(a, side * b) for b in across.tolist() for a in along.tolist())


def _house(length_m: float, depth_m: float, high_m: float, *, pointed: bool) -> Mesh:
    what, wall = StreetClass.BUILDING, Material.WALL
    body = box(length_m, depth_m, 0.0, high_m + 1.5, what=what, material=wall)
    if not pointed:
        return body
    half_l, half_d, eaves, ridge = length_m / 2, depth_m / 2 + 0.3, high_m + 1.5, high_m + 5.0
    roof = np.array(
        [
            *[(-half_l, -half_d, eaves), (half_l, -half_d, eaves), (half_l, half_d, eaves)],
            *[(-half_l, half_d, eaves), (-half_l, 0.0, ridge), (half_l, 0.0, ridge)],
        ]
    )
    faces = [(0, 1, 5), (0, 5, 4), (2, 3, 4), (2, 4, 5), (0, 4, 3), (1, 2, 5)]
    return Mesh.merged([body, Mesh.of(roof, faces, what, Material.STONE)])


def _relief(build: Builder, start_m: float, length_m: float, front_m: float, high_m: float) -> None:
    """Add pillars, porches, balconies and window panes to one façade."""
    rng, what = build.rng, StreetClass.BUILDING
    if rng.random() < 0.6:
        at = start_m + length_m * float(rng.uniform(0.2, 0.8))
        build.block((1.8, 1.0, 0.0, 3.2), what, Material.WALL, at, front_m)
    ends = np.arange(start_m + 0.3, start_m + length_m, float(rng.uniform(2.4, 4.2))).tolist()
    for at in ends:
        build.block((0.5, 0.7, 0.0, high_m - 0.4), what, Material.WALL, at, front_m)
    for floor_m in np.arange(0.0, high_m - 2.0, 3.1).tolist():
        for at in ends[:-1]:
            pane = (1.1, 0.06, floor_m + 1.0, floor_m + 2.3)
            outside = front_m - 0.02 * float(np.sign(front_m))
            build.block(pane, what, Material.GLASS, at + 1.3, outside)
        for at in ends[::2] if floor_m > 2.0 else []:
            if rng.random() < 0.5:
                slab = (1.8, 2.2, floor_m, floor_m + 1.0)
                build.block(slab, what, Material.WALL, at + 1.0, front_m)


def garden_line_m(place: Place) -> float:
    """Return the distance of fences, walls and hedges from the middle of the road, metres."""
    return place.kerb_m + max(place.pavement_m, 2.0) + 0.4


def gardens(build: Builder, from_m: float, to_m: float, side: int) -> None:
    """Close gardens off with fences, walls or hedges."""
    place, rng = build.place, build.rng
    line = side * garden_line_m(place)
    at = from_m
    while at < to_m - 4.0:
        length = float(rng.uniform(8.0, 24.0))
        sort = rng.random()
        for piece in np.arange(at + 1.0, min(at + length - 2.5, to_m), 2.0):
            if not build.free(float(piece), line, 1.0):
                continue
            if sort < 0.35:
                build.put(hedge(int(piece) % SORTS), float(piece), line)
            elif sort < 0.6:
                build.put(_fence(), float(piece), line, sunk_m=0.05)
            elif sort < 0.8:
                low_wall = (2.02, 0.25, -0.2, 1.2)
                build.block(low_wall, StreetClass.FENCE, Material.STONE, float(piece), line)
        at += length


@cache
def _fence() -> Mesh:
    """Build two metres of picket fence with gaps."""
    what, wood = StreetClass.FENCE, Material.WOOD
    slats = [
        box(0.09, 0.03, 0.05, 1.15, what=what, material=wood, x_m=float(x))
        for x in np.arange(-0.95, 1.0, 0.19)
    ]
    bars = [box(2.0, 0.05, z, z + 0.08, what=what, material=wood, y_m=0.04) for z in (0.3, 0.9)]
    return Mesh.merged([*slats, *bars])


def barriers(build: Builder, from_m: float, to_m: float, side: int) -> None:
    """Add a median barrier, guard rails, noise walls and sign gantries."""
    rng, place = build.rng, build.place
    fence, metal = StreetClass.FENCE, Material.METAL
    noise_wall = rng.random() < 0.5
    rail_m, wall_m = side * (place.kerb_m + 0.6), side * (place.kerb_m + 5.0)
    for at in np.arange(from_m, to_m, 4.0):
        along = float(at) + 2.0
        if side > 0:
            build.block((4.05, 0.5, -0.1, 0.9), fence, Material.STONE, along, 0.0)
        build.block((4.05, 0.08, 0.45, 0.78), fence, metal, along, rail_m)
        build.block((0.12, 0.1, 0.0, 0.7), fence, metal, along, rail_m)
        if noise_wall:
            house = StreetClass.BUILDING
            build.block((3.9, 0.2, -0.4, 4.0), house, Material.WALL, along, wall_m)
            build.block((0.25, 0.35, -0.4, 4.2), house, metal, along + 2.0, wall_m)
    for at in np.arange(from_m + 60.0, to_m, 210.0) if side > 0 else []:
        half = place.kerb_m + 1.2
        pole = StreetClass.POLE
        beam = limb((0.0, -half, 6.4), (0.0, half, 6.4), 0.2, 0.2, what=pole, material=metal)
        legs = [
            limb((0.0, y, -0.3), (0.0, y, 6.5), 0.2, 0.2, what=pole, material=metal)
            for y in (-half, half)
        ]
        boards = [
            box(0.1, 4.0, 5.6, 7.6, what=StreetClass.SIGN, material=Material.MIRROR, y_m=y)
            for y in (-7.0, 7.0)
        ]
        build.put(Mesh.merged([beam, *legs, *boards]), float(at), 0.0)
