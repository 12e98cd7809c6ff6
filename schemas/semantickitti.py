"""Ids and names of the classes of the SemanticKITTI format, and of LiDAR-MOS."""

from collections.abc import Mapping
from typing import Final

PLAIN: Final[Mapping[int, str]] = {
    9: "static",
    40: "road",
    44: "parking",
    48: "sidewalk",
    49: "other-ground",
    50: "building",
    51: "fence",
    52: "other-structure",
    60: "lane-marking",
    70: "vegetation",
    71: "trunk",
    72: "terrain",
    80: "pole",
    81: "traffic-sign",
    99: "other-object",
}
"""Ids of surfaces and structures, which cannot move; 9 is LiDAR-MOS's."""

MOVABLE: Final[Mapping[int, str]] = {
    10: "car",
    11: "bicycle",
    13: "bus",
    15: "motorcycle",
    16: "on-rails",
    18: "truck",
    20: "other-vehicle",
    30: "person",
    31: "bicyclist",
    32: "motorcyclist",
}
"""Ids of things at rest that can move."""

MOVING: Final[Mapping[int, str]] = {
    251: "moving",
    252: "moving-car",
    253: "moving-bicyclist",
    254: "moving-person",
    255: "moving-motorcyclist",
    256: "moving-on-rails",
    257: "moving-bus",
    258: "moving-truck",
    259: "moving-other-vehicle",
}
"""Ids of things in motion; 251 is LiDAR-MOS's, without a class."""
