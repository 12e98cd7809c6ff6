"""Places of scenes and of what they show: distances, cells, and words. Pure."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from schemas.surroundings import (
    EARTH,
    METRES_PER_DEGREE,
    ScenePlace,
    metres_per_degree_east,
)

CELL_M: Final = 100.0
"""Edge of a cell of places, metres: a stretch of a street with its crossing, as people mean it."""


@dataclass(frozen=True, slots=True)
class Spot:
    """A point in a frame that drives share.

    Attributes:
        frame: `wgs84`, or the name of a frame in metres.
        first: Latitude in degrees, or x in metres.
        second: Longitude in degrees, or y in metres.
    """

    frame: str
    first: float
    second: float

    def shifted(self, first_m: float, second_m: float) -> "Spot":
        """Return the spot some metres north and east (or along x and y) of this one."""
        if self.frame != EARTH:
            return Spot(self.frame, self.first + first_m, self.second + second_m)
        return Spot(
            EARTH,
            self.first + first_m / METRES_PER_DEGREE,
            self.second + second_m / metres_per_degree_east(self.first),
        )

    def cell(self, edge_m: float) -> tuple[str, int, int]:
        """Return the cell of a grid of this edge in which the spot lies."""
        if self.frame != EARTH:
            return self.frame, math.floor(self.first / edge_m), math.floor(self.second / edge_m)
        row = math.floor(self.first * METRES_PER_DEGREE / edge_m)
        turned = (self.second + 180.0) % 360.0
        east_m = metres_per_degree_east((row + 0.5) * edge_m / METRES_PER_DEGREE)
        return EARTH, row, math.floor(turned * east_m / edge_m)

    def cells_around(self, edge_m: float) -> Iterator[tuple[str, int, int]]:
        """Yield its cell and those within one edge of it, each once."""
        steps = (-edge_m, 0.0, edge_m)
        yield from {self.shifted(one, other).cell(edge_m) for one in steps for other in steps}


def spot_of(place: ScenePlace) -> Spot:
    """Return where a scene was recorded."""
    first = place.x_m if place.latitude_deg is None else place.latitude_deg
    second = place.y_m if place.longitude_deg is None else place.longitude_deg
    if first is None or second is None:
        raise ValueError("a place without coordinates")  # its model refuses them
    return Spot(place.frame, first, second)


def spot_in(place: ScenePlace, odom_m: tuple[float, float]) -> Spot | None:
    """Return the spot of a point in the odom space of a scene; None without its direction."""
    if place.odom_yaw_rad is None:
        return None
    x_m, y_m = odom_m[0] - place.odom_m[0], odom_m[1] - place.odom_m[1]
    cos, sin = math.cos(place.odom_yaw_rad), math.sin(place.odom_yaw_rad)
    east_m, north_m = cos * x_m - sin * y_m, sin * x_m + cos * y_m
    here = spot_of(place)
    return here.shifted(north_m, east_m) if here.frame == EARTH else here.shifted(east_m, north_m)


def apart_m(one: Spot, other: Spot) -> float:
    """Return the distance of two spots, metres; infinite in different frames."""
    if one.frame != other.frame:
        return math.inf
    first, second = one.first - other.first, one.second - other.second
    if one.frame != EARTH:
        return math.hypot(first, second)
    second = (second + 180.0) % 360.0 - 180.0
    east_m = second * metres_per_degree_east((one.first + other.first) / 2)
    return math.hypot(first * METRES_PER_DEGREE, east_m)


def name_of_cell(place: ScenePlace | None) -> str:
    """Name the cell of a place by its corner; empty without a place."""
    if place is None:
        return ""
    frame, row, column = spot_of(place).cell(CELL_M)
    if frame != EARTH:
        return f"{frame} {row * CELL_M:.0f} {column * CELL_M:.0f}"
    south = row * CELL_M / METRES_PER_DEGREE
    east_m = metres_per_degree_east((row + 0.5) * CELL_M / METRES_PER_DEGREE)
    return f"{south:.4f} {column * CELL_M / east_m - 180.0:.4f}"


def text_of(place: ScenePlace) -> str:
    """Return the coordinates of a place on a line."""
    spot = spot_of(place)
    if spot.frame != EARTH:
        return f"{spot.frame} {spot.first:.1f}, {spot.second:.1f}"
    return f"{spot.first:.6f}, {spot.second:.6f}"


def turn_between_rad(one: float, other: float) -> float:
    """Return the angle between two directions, 0 to pi."""
    return abs((one - other + math.pi) % (2.0 * math.pi) - math.pi)
