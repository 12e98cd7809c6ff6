"""Street furniture: poles, lamps, signs, traffic lights, bollards, cabinets."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from workers.lab.simulation.models.kinds import Material, StreetClass
from workers.lab.simulation.models.meshes import Mesh, box, limb
from workers.lab.simulation.world.builder import Builder, Network


def furniture(build: Builder, from_m: float, to_m: float, side: int) -> None:
    """Place poles, lamps, signs, lights, bollards, cabinets and bins along the carriageway."""
    place, rng = build.place, build.rng
    kerb = side * (place.kerb_m + (0.6 if place.pavement_m else 1.4))
    at = from_m + float(rng.uniform(1.0, 6.0))
    thing = StreetClass.OBJECT
    while at < to_m - 2.0:
        draw = rng.random()
        if not build.free(at, kerb, 1.0):
            at += 2.0
            continue
        if draw < 0.3:
            build.put(_lamp(float(rng.uniform(5.0, 8.0))), at, kerb, turned_rad=np.pi / 2 * -side)
        elif draw < 0.5:
            build.put(_sign(rng), at, kerb, turned_rad=0.0 if side < 0 else np.pi)
        elif draw < 0.65 and place.pavement_m:
            for step in (0.0, 1.4, 2.8):
                if build.free(at + step, kerb, 1.0):
                    build.put(_unit_rod(), at + step, kerb, scale=(0.22, 0.22, 0.95))
        elif draw < 0.8 and place.pavement_m:
            long, high = float(rng.uniform(0.6, 1.6)), float(rng.uniform(0.9, 1.6))
            deep = side * (place.kerb_m + min(place.pavement_m, 3.6) - 0.7)
            build.block((long, 0.7, 0.0, high), thing, Material.METAL, at, deep)
        elif draw < 0.9:
            wide = 0.58 if place.pavement_m else 0.12  # a bin, or a post that marks the edge
            build.put(_unit_rod(), at, kerb, scale=(wide, wide, 1.0))
        at += float(rng.uniform(4.0, 12.0)) * (1.0 if place.pavement_m else 4.0)


@cache
def _unit_rod() -> Mesh:
    return limb(
        *((0, 0, 0), (0, 0, 1.0), 0.5, 0.5), what=StreetClass.OBJECT, material=Material.METAL
    )


def _lamp(high_m: float) -> Mesh:
    pole, metal = StreetClass.POLE, Material.METAL
    return Mesh.merged(
        [
            limb((0, 0, -0.2), (0, 0, high_m), 0.1, 0.06, what=pole, material=metal),
            limb((0, 0, high_m), (1.4, 0, high_m + 0.2), 0.05, 0.04, what=pole, material=metal),
            box(0.6, 0.25, high_m + 0.1, high_m + 0.25, what=pole, material=metal, x_m=1.5),
        ]
    )


def _sign(rng: np.random.Generator) -> Mesh:
    high, wide = float(rng.uniform(2.2, 3.0)), float(rng.uniform(0.5, 0.9))
    return Mesh.merged(
        [
            limb(
                (0, 0, -0.2),
                (0, 0, high),
                0.04,
                0.04,
                what=StreetClass.POLE,
                material=Material.METAL,
            ),
            box(
                *(0.03, wide, high - wide, high),
                what=StreetClass.SIGN,
                material=Material.MIRROR,
                x_m=-0.06,
            ),
        ]
    )


def junction_furniture(
    network: Network, main: int, junctions_m: Sequence[float], rng: np.random.Generator
) -> list[Mesh]:
    """Place traffic lights at the corners of junctions."""
    build = Builder(network, main, 1.0, rng)
    pole = StreetClass.POLE
    light = Mesh.merged(
        [
            limb((0, 0, -0.2), (0, 0, 3.4), 0.08, 0.07, what=pole, material=Material.METAL),
            box(0.3, 0.35, 2.4, 3.4, what=StreetClass.SIGN, material=Material.METAL),
        ]
    )
    place = build.place
    for at in junctions_m:
        for ahead in (1, -1):
            for side in (1, -1):
                build.put(light, at + ahead * (place.kerb_m + 1.0), side * (place.kerb_m + 0.8))
    return build.meshes()
