"""What stands and moves in a street: classes, sizes and the upright shapes they are made of."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final


class StreetClass(IntEnum):
    """Semantic class of a simulated point; the ids of `classes.json` beside the truth."""

    ROAD = 1
    SIDEWALK = 2
    BUILDING = 3
    VEGETATION = 4
    TRUNK = 5
    POLE = 6
    OBJECT = 7
    CAR = 8
    TRUCK = 9
    PEDESTRIAN = 10
    CYCLIST = 11


GROUND: Final = (StreetClass.ROAD, StreetClass.SIDEWALK)
MOVABLE: Final = (
    StreetClass.CAR,
    StreetClass.TRUCK,
    StreetClass.PEDESTRIAN,
    StreetClass.CYCLIST,
)

SEMANTIC_KITTI: Final[dict[StreetClass, int]] = {
    StreetClass.ROAD: 9,
    StreetClass.SIDEWALK: 11,
    StreetClass.BUILDING: 13,
    StreetClass.VEGETATION: 15,
    StreetClass.TRUNK: 16,
    StreetClass.POLE: 18,
    StreetClass.OBJECT: 0,
    StreetClass.CAR: 1,
    StreetClass.TRUCK: 4,
    StreetClass.PEDESTRIAN: 6,
    StreetClass.CYCLIST: 7,
}
"""Each class among the 19 of SemanticKITTI (Behley et al., ICCV 2019), 0 none of them."""

REFLECTIVITY: Final[dict[StreetClass, float]] = {
    StreetClass.ROAD: 0.12,
    StreetClass.SIDEWALK: 0.25,
    StreetClass.BUILDING: 0.35,
    StreetClass.VEGETATION: 0.30,
    StreetClass.TRUNK: 0.20,
    StreetClass.POLE: 0.45,
    StreetClass.OBJECT: 0.30,
    StreetClass.CAR: 0.40,
    StreetClass.TRUCK: 0.50,
    StreetClass.PEDESTRIAN: 0.30,
    StreetClass.CYCLIST: 0.30,
}
"""Share of the light that comes back, about what near-infrared lidars see of these materials."""


@dataclass(frozen=True, slots=True)
class Shape:
    """An upright prism: a box turned about z, or a round column.

    Attributes:
        x_m: Centre along the length axis of what it belongs to (world x for the street itself).
        y_m: Centre across, metres, positive to the left.
        yaw_rad: Heading of its own length axis in that space.
        length_m: Along its own axis; the diameter of a round one.
        width_m: Across; equal to the length of a round one.
        low_m: Underside above the road.
        high_m: Top above the road.
        street_class: What a return from it is.
        is_round: Whether its footprint is a circle.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    length_m: float
    width_m: float
    low_m: float
    high_m: float
    street_class: StreetClass
    is_round: bool = False


def column(
    x_m: float, y_m: float, *, diameter_m: float, low_m: float, high_m: float, what: StreetClass
) -> Shape:
    """Make a round shape: a pole, a trunk, a crown, a person."""
    return Shape(x_m, y_m, 0.0, diameter_m, diameter_m, low_m, high_m, what, is_round=True)


def _car() -> tuple[Shape, ...]:
    car = StreetClass.CAR
    return (
        Shape(0.0, 0.0, 0.0, 4.4, 1.80, 0.22, 0.90, car),
        Shape(-0.25, 0.0, 0.0, 2.5, 1.56, 0.90, 1.46, car),
    )


def _truck() -> tuple[Shape, ...]:
    truck = StreetClass.TRUCK
    return (
        Shape(3.0, 0.0, 0.0, 2.0, 2.40, 0.40, 2.60, truck),
        Shape(-0.9, 0.0, 0.0, 5.6, 2.50, 0.90, 3.40, truck),
    )


def _pedestrian() -> tuple[Shape, ...]:
    person = StreetClass.PEDESTRIAN
    return (
        column(0.0, 0.0, diameter_m=0.40, low_m=0.02, high_m=0.85, what=person),
        column(0.0, 0.0, diameter_m=0.52, low_m=0.85, high_m=1.50, what=person),
        column(0.0, 0.0, diameter_m=0.24, low_m=1.50, high_m=1.75, what=person),
    )


def _cyclist() -> tuple[Shape, ...]:
    rider = StreetClass.CYCLIST
    return (
        Shape(0.0, 0.0, 0.0, 1.70, 0.12, 0.02, 0.95, rider),
        column(-0.1, 0.0, diameter_m=0.50, low_m=0.80, high_m=1.75, what=rider),
    )


SHAPES: Final[dict[StreetClass, tuple[Shape, ...]]] = {
    StreetClass.CAR: _car(),
    StreetClass.TRUCK: _truck(),
    StreetClass.PEDESTRIAN: _pedestrian(),
    StreetClass.CYCLIST: _cyclist(),
}
"""What each kind of actor is made of, in its own space: x ahead, origin at its middle."""

SIZE_M: Final[dict[StreetClass, tuple[float, float, float]]] = {
    StreetClass.CAR: (4.4, 1.8, 1.46),
    StreetClass.TRUCK: (7.7, 2.5, 3.4),
    StreetClass.PEDESTRIAN: (0.52, 0.52, 1.75),
    StreetClass.CYCLIST: (1.7, 0.5, 1.75),
}
"""Length, width and height of the box around each kind of actor."""
