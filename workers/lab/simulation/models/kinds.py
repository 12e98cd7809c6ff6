"""Classes and surface materials of simulated objects."""

from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray


class StreetClass(IntEnum):
    """Semantic class of a simulated point; the ids of `classes.json` in the truth folder."""

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
    VAN = 12
    BUS = 13
    MOTORCYCLE = 14
    ANIMAL = 15
    FENCE = 16
    SIGN = 17
    TERRAIN = 18
    NOISE = 19
    EGO = 20


GROUND: Final = (StreetClass.ROAD, StreetClass.SIDEWALK, StreetClass.TERRAIN)
VEHICLES: Final = (
    StreetClass.CAR,
    StreetClass.VAN,
    StreetClass.TRUCK,
    StreetClass.BUS,
    StreetClass.MOTORCYCLE,
)
MOVABLE: Final = (
    *VEHICLES,
    StreetClass.PEDESTRIAN,
    StreetClass.CYCLIST,
    StreetClass.ANIMAL,
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
    StreetClass.VAN: 1,
    StreetClass.BUS: 5,
    StreetClass.MOTORCYCLE: 8,
    StreetClass.ANIMAL: 0,
    StreetClass.FENCE: 14,
    StreetClass.SIGN: 19,
    StreetClass.TERRAIN: 17,
    StreetClass.NOISE: 0,
    StreetClass.EGO: 0,
}
"""Class of SemanticKITTI (Behley et al., ICCV 2019) among its 19, by class; 0 for none.

A van is a car there, a bus an other-vehicle, and a motorcycle a motorcyclist, since all motorcycles
have riders here.
"""


class Material(IntEnum):
    """Material of a surface; `COLOURED` has the reflectivity of its actor."""

    COLOURED = 0
    ASPHALT = 1
    STONE = 2
    GRASS = 3
    WALL = 4
    LEAF = 5
    BARK = 6
    METAL = 7
    WOOD = 8
    GLASS = 9
    RUBBER = 10
    MIRROR = 11
    SKIN = 12
    MARKING = 13


REFLECTIVITY: Final[NDArray[np.float64]] = np.array(
    [0.4, 0.13, 0.25, 0.35, 0.35, 0.40, 0.20, 0.45, 0.30, 0.15, 0.05, 2.0, 0.4, 0.45]
)
"""Share of near-infrared light that is reflected, by `Material`; `MIRROR` is retroreflecting foil.
"""

PASSES: Final[NDArray[np.float64]] = np.array(
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0]
)
"""Share of pulses that pass through and are lost, by `Material`.

Most light through a pane returns from seats and rooms behind it. These are not modelled, so such
pulses end at the pane.
"""
