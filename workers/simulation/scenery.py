"""What stands along a street: facades, pavements, trees, poles, bins; gaps where others cross."""

from typing import Final

import numpy as np

from workers.simulation.drive import Road
from workers.simulation.kinds import Shape, StreetClass, column

KERB_M: Final = 9.6
"""Distance of the kerbs from the centre of the road."""

FACADE_M: Final = 13.4
"""Distance of the nearest facades."""

JUNCTION_HALF_M: Final = 8.0
"""Half the width of a crossing street."""


def build_scenery(
    road: Road, *, from_m: float, to_m: float, junctions_m: list[float], rng: np.random.Generator
) -> list[Shape]:
    """Line both sides of the road between two path lengths.

    Porches and pillars face along the road: without them odometry would slide on smooth fronts.
    """
    shapes: list[Shape] = []
    for side in (1, -1):
        for start, end in _between(from_m, to_m, junctions_m):
            shapes += _pavement(road, start, end, side)
            shapes += _facades(road, start, end, side, rng)
            shapes += _furniture(road, start, end, side, rng)
        for junction in junctions_m:
            shapes.append(_house(road, junction, side * 62.0, 30.0, 8.0, 14.0))
    return shapes


def _between(from_m: float, to_m: float, junctions_m: list[float]) -> list[tuple[float, float]]:
    edges = [from_m, *(e for j in junctions_m for e in (j - JUNCTION_HALF_M, j + JUNCTION_HALF_M))]
    edges.append(to_m)
    return list(zip(edges[::2], edges[1::2], strict=True))


def _turned(
    road: Road,
    along_m: float,
    across_m: float,
    size_m: tuple[float, float, float, float],
    what: StreetClass,
) -> Shape:
    x, y, heading = road.place(along_m, across_m)
    length, width, low, high = size_m
    return Shape(float(x), float(y), float(heading), length, width, low, high, what)


def _house(
    road: Road, along_m: float, across_m: float, length_m: float, depth_m: float, high_m: float
) -> Shape:
    return _turned(road, along_m, across_m, (length_m, depth_m, 0.0, high_m), StreetClass.BUILDING)


def _pavement(road: Road, start_m: float, end_m: float, side: int) -> list[Shape]:
    width, step = 8.0, 10.0
    middle = side * (KERB_M + width / 2)
    return [
        _turned(road, at, middle, (step + 0.4, width, 0.0, 0.14), StreetClass.SIDEWALK)
        for at in np.arange(start_m + step / 2, end_m, step)
    ]


def _facades(
    road: Road, start_m: float, end_m: float, side: int, rng: np.random.Generator
) -> list[Shape]:
    houses, at = [], start_m
    while at < end_m - 3.0:
        length = min(float(rng.uniform(7.0, 18.0)), end_m - at)
        depth, high = float(rng.uniform(8.0, 14.0)), float(rng.uniform(5.0, 18.0))
        back = float(rng.choice([0.0, 0.0, 0.6, 1.5, 3.0]))
        across = side * (FACADE_M + back + depth / 2)
        houses.append(_house(road, at + length / 2, across, length, depth, high))
        front = side * (FACADE_M + back)
        if rng.random() < 0.6:
            houses.append(_house(road, at + length * rng.uniform(0.2, 0.8), front, 1.8, 1.0, 3.2))
        houses += _relief(road, at, length, front, high, rng)
        at += length + float(rng.choice([0.0, 0.0, 3.0]))
    return houses


def _relief(
    road: Road,
    start_m: float,
    length_m: float,
    front_m: float,
    high_m: float,
    rng: np.random.Generator,
) -> list[Shape]:
    """Pillars and balconies of one front."""
    ends = np.arange(start_m + 0.3, start_m + length_m, float(rng.uniform(2.4, 4.2))).tolist()
    relief = [_house(road, at, front_m, 0.5, 0.7, high_m - 0.4) for at in ends]
    for floor_m in np.arange(3.0, high_m - 2.0, 3.1).tolist():
        for at in ends[::2]:
            if rng.random() < 0.5:
                size = (1.8, 2.2, floor_m, floor_m + 1.0)
                relief.append(_turned(road, at + 1.0, front_m, size, StreetClass.BUILDING))
    return relief


def _furniture(
    road: Road, start_m: float, end_m: float, side: int, rng: np.random.Generator
) -> list[Shape]:
    """Put trees, poles, bollards, cabinets and hedges on the pavement."""
    shapes: list[Shape] = []
    kerb, wall = side * (KERB_M + 0.6), side * (FACADE_M - 0.9)
    at = start_m + float(rng.uniform(1.0, 4.0))
    while at < end_m - 2.0:
        x, y, _ = (float(v) for v in road.place(at, kerb))
        draw = rng.random()
        if draw < 0.35:
            shapes += _tree(x, y, rng)
        elif draw < 0.6:
            high = float(rng.uniform(2.5, 8.0))
            pole = StreetClass.POLE
            shapes.append(column(x, y, diameter_m=0.16, low_m=0.0, high_m=high, what=pole))
        elif draw < 0.75:
            shapes += [
                _turned(road, at + step, kerb, (0.25, 0.25, 0.0, 0.95), StreetClass.OBJECT)
                for step in (0.0, 1.4, 2.8)
            ]
        elif draw < 0.88:
            size = (float(rng.uniform(0.6, 1.6)), 0.7, 0.0, float(rng.uniform(0.9, 1.6)))
            shapes.append(_turned(road, at, wall, size, StreetClass.OBJECT))
        else:
            size = (float(rng.uniform(2.0, 5.0)), 0.9, 0.0, float(rng.uniform(0.8, 1.5)))
            shapes.append(_turned(road, at, wall, size, StreetClass.VEGETATION))
        at += float(rng.uniform(3.0, 9.0))
    return shapes


def _tree(x_m: float, y_m: float, rng: np.random.Generator) -> list[Shape]:
    crown = float(rng.uniform(2.0, 3.2))
    leaves = StreetClass.VEGETATION
    trunk = column(x_m, y_m, diameter_m=0.3, low_m=0.0, high_m=2.8, what=StreetClass.TRUNK)
    return [
        trunk,
        column(x_m, y_m, diameter_m=0.8 * crown, low_m=2.6, high_m=3.4, what=leaves),
        column(x_m, y_m, diameter_m=crown, low_m=3.4, high_m=5.0, what=leaves),
        column(x_m, y_m, diameter_m=0.6 * crown, low_m=5.0, high_m=6.0, what=leaves),
    ]
