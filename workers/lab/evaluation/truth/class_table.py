"""Coarse classes of the semantic evaluation, common to all data sets and networks."""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

COARSE: Final = (
    *("none", "car", "large_vehicle", "two_wheeler", "pedestrian", "road", "sidewalk"),
    *("other_ground", "vegetation", "building", "traffic_facility", "other_static"),
)
"""Index 0 is a point without a true class, or without an answer of the network."""

MOVABLE: Final = ("car", "large_vehicle", "two_wheeler", "pedestrian")

_OF_NAME: Final[Mapping[str, str]] = {
    **{name: name for name in COARSE[1:]},
    "bicycle": "two_wheeler",
    "motorcycle": "two_wheeler",
    "bicyclist": "two_wheeler",
    "motorcyclist": "two_wheeler",
    "cyclist": "two_wheeler",
    "van": "car",
    "truck": "large_vehicle",
    "bus": "large_vehicle",
    "other-vehicle": "large_vehicle",
    "person": "pedestrian",
    "parking": "road",
    "other-ground": "other_ground",
    "terrain": "other_ground",
    "fence": "other_static",
    "trunk": "vegetation",
    "pole": "traffic_facility",
    "traffic-sign": "traffic_facility",
    "sign": "traffic_facility",
}

SEMANTIC_KITTI: Final = (
    *("unlabeled", "car", "bicycle", "motorcycle", "truck", "other-vehicle", "person"),
    *("bicyclist", "motorcyclist", "road", "parking", "sidewalk", "other-ground", "building"),
    *("fence", "vegetation", "trunk", "terrain", "pole", "traffic-sign"),
)
"""The 19 classes of SemanticKITTI (Behley et al., ICCV 2019), by their number."""


def coarse_of_names(names: tuple[str, ...]) -> NDArray[np.uint8]:
    """Return the coarse class of each name; 0 where there is none."""
    return np.array([COARSE.index(_OF_NAME.get(name, "none")) for name in names], dtype=np.uint8)


def coarse_of_name(name: str) -> int:
    """Return the coarse class of a name that truth gives an object: `Pickup Truck`, `BUS`; 0 none.

    The last word of a name of several words counts where the whole is not known.
    """
    plain = name.strip().lower().replace("_", " ")
    for each in (plain.replace(" ", "-"), plain, plain.split(" ")[-1]):
        if each in _OF_NAME:
            return COARSE.index(_OF_NAME[each])
    return 0


@cache
def coarse_of_ids(folder: Path) -> NDArray[np.uint8] | None:
    """Return the coarse class of each id of a data set, from the nearest `classes.json` above it.

    Args:
        folder: Folder of the truth of one log.

    Returns:
        (256,) coarse classes; None where no table defines the ids.
    """
    of_kitti = coarse_of_names(SEMANTIC_KITTI)
    for above in (folder, *folder.parents):
        path = above / "classes.json"
        if not path.is_file():
            continue
        listed = json.loads(path.read_text())
        if isinstance(listed, dict) and "classes" in listed:
            table = np.zeros(256, dtype=np.uint8)
            for entry in listed["classes"]:
                table[entry["id"]] = of_kitti[entry["semantickitti19"]]
            return table
        return None
    return None
