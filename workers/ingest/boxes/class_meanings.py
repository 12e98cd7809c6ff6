"""Meaning of the names of classes in boxes: the log's own classes first, common names after."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from schemas.frame import RecordedClass

MOVABLE: Final = frozenset(
    {
        "car",
        "suv",
        "van",
        "pickup",
        "truck",
        "bus",
        "tram",
        "train",
        "trailer",
        "vehicle",
        "caravan",
        "motorcycle",
        "motorbike",
        "bicycle",
        "bike",
        "cyclist",
        "rider",
        "motorcyclist",
        "bicyclist",
        "scooter",
        "pedestrian",
        "person",
        "human",
        "child",
        "adult",
        "animal",
        "dog",
        "wheelchair",
        "stroller",
        "construction_vehicle",
        "emergency_vehicle",
        "other_vehicle",
        "otherride",
        "kickboard",
        "large_vehicle",
        "passenger_vehicle",
        "semi_truck",
        "medium_sized_truck",
        "pickup_truck",
        "towed_object",
        "pedestrian_with_object",
        "personal_mobility_device",
        "bicycle_rider",
        "motorcycle_rider",
        "two_wheeler",
    }
)
"""Common names of what can move by itself, in lower case with underscores."""

IMMOVABLE: Final = frozenset(
    {
        "cone",
        "cones",
        "traffic_cone",
        "construction_cone",
        "barrier",
        "temporary_construction_barriers",
        "sign",
        "traffic_sign",
        "signs",
        "pole",
        "pylon",
        "bollard",
        "building",
        "vegetation",
        "tree",
        "wall",
        "fence",
        "road",
        "ground",
        "sidewalk",
        "terrain",
        "curb",
        "hydrant",
        "fire_hydrant",
        "traffic_light",
        "rolling_containers",
        "road_barriers",
        "construction_signs",
        "over_drivable",
        "under_drivable",
    }
)
"""Common names of what cannot."""


@dataclass(frozen=True, slots=True)
class ClassMeaning:
    """Meaning of one class.

    Attributes:
        name: Its name in records.
        movable: Whether it can move; None where no mapping knows it.
        moving: Whether it means that it moves.
    """

    name: str
    movable: bool | None
    moving: bool = False


class ClassMeanings:
    """Meanings by name.

    Args:
        classes: The log's classes, by the id of the model, from `counterpoint.classes`; their names
            and their ids both name a class of a box.
    """

    def __init__(self, classes: Mapping[int, RecordedClass]) -> None:
        self._known: dict[str, ClassMeaning] = {}
        for class_id, each in classes.items():
            meaning = ClassMeaning(each.name, each.movable, each.moving)
            self._known.setdefault(str(class_id), meaning)
            self._known[each.name] = self._known[_plain(each.name)] = meaning

    def of(self, name: str) -> ClassMeaning:
        """Return the meaning of a class; its own name with nothing known where none has it."""
        found = self._known.get(name) or self._known.get(_plain(name))
        if found is not None:
            return found
        plain = _plain(name)
        words = {plain, *plain.split(".")}  # nuScenes writes vehicle.car
        movable = True if words & MOVABLE else False if words & IMMOVABLE else None
        return ClassMeaning(name, movable)


def _plain(name: str) -> str:
    return name.strip().lower().replace(" ", "_").replace("-", "_")
