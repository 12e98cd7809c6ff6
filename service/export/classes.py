"""Classes of SemanticKITTI: ids of classes at rest and in motion, by the names of a stream."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

UNLABELLED: Final = 0
OTHER_MOVING: Final = 259
"""Moving thing without a class of its own: `moving-other-vehicle`."""

NAMES: Final = {
    0: "unlabeled",
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
    252: "moving-car",
    253: "moving-bicyclist",
    254: "moving-person",
    255: "moving-motorcyclist",
    256: "moving-on-rails",
    257: "moving-bus",
    258: "moving-truck",
    259: "moving-other-vehicle",
}
"""Ids that an export writes, as in `semantic-kitti.yaml`."""

_IDS: Final = {name.replace("-", "_"): number for number, name in NAMES.items() if number < 252}
_OTHER_NAMES: Final = {
    "cyclist": 31,
    "rider": 31,
    "two_wheeler": 11,
    "pedestrian": 30,
    "human": 30,
    "large_vehicle": 18,
    "lorry": 18,
    "van": 10,
    "vehicle": 20,
    "trailer": 20,
    "train": 16,
    "tram": 16,
    "other_ground": 72,
    "ground": 49,
    "traffic_facility": 80,
    "other_static": 99,
}
"""Names of other data sets and of the streams' coarse classes.

A `two_wheeler` at rest is a bicycle, and one in motion has a rider. `other_ground` is terrain."""

_MOVING: Final = {
    10: 252,
    11: 253,
    31: 253,
    30: 254,
    15: 255,
    32: 255,
    16: 256,
    13: 257,
    18: 258,
}


def semantickitti_ids(class_names: Sequence[str]) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return the ids of each class at rest and in motion; the last entries are of no class.

    Args:
        class_names: Classes of the supervised stream.

    Returns:
        Two (C + 1,) arrays. A class that SemanticKITTI does not have is 0 at rest.
    """
    still = [_id_of(name) for name in class_names] + [UNLABELLED]
    moving = [_MOVING.get(each, OTHER_MOVING) for each in still]
    return np.array(still, dtype=np.uint32), np.array(moving, dtype=np.uint32)


def _id_of(name: str) -> int:
    plain = name.strip().lower().replace("-", "_").replace(" ", "_")
    for each in (plain, plain.rpartition(".")[2]):
        number = _IDS.get(each, _OTHER_NAMES.get(each))
        if number is not None:
            return number
    return UNLABELLED
