"""Classes of SemanticKITTI: ids of classes at rest and in motion, by the names of a stream."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.semantickitti import MOVABLE, MOVING, PLAIN

UNLABELLED: Final = 0
MOVING_ATTRIBUTE: Final = "moving"
"""Attribute of a cuboid in every format: if its object moves in this frame."""

OTHER_MOVING: Final = 259
"""Moving thing without a class of its own: `moving-other-vehicle`."""

_OF_LIDAR_MOS: Final = frozenset({9, 251})
NAMES: Final = {
    number: name
    for number, name in {UNLABELLED: "unlabeled", **MOVABLE, **PLAIN, **MOVING}.items()
    if number not in _OF_LIDAR_MOS
}
"""Ids that an export writes, as in `semantic-kitti.yaml`."""

_IDS: Final = {name.replace("-", "_"): number for number, name in NAMES.items() if number < 252}
_MOVING_IDS: Final = {
    name.replace("-", "_"): number for number, name in NAMES.items() if number >= 252
}
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


def moving_class(name: str) -> int:
    """Return the class of a moving thing of this name, as `moving-car`; 0: it names none."""
    return _MOVING_IDS.get(_plain(name), UNLABELLED)


def _id_of(name: str) -> int:
    plain = _plain(name)
    for each in (plain, plain.rpartition(".")[2]):
        number = _IDS.get(each, _OTHER_NAMES.get(each))
        if number is not None:
            return number
    return UNLABELLED


def _plain(name: str) -> str:
    return name.strip().lower().replace("-", "_").replace(" ", "_")
