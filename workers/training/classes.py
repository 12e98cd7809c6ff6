"""What the supervised stream is taught: the classes of its two networks."""

from typing import Final

from workers.supervised.classes import ClassMeaning
from workers.supervised.lmnet import MOTION_CLASSES

CLASSES: Final[tuple[tuple[str, bool], ...]] = (
    ("unlabeled", False),
    ("car", True),
    ("large_vehicle", True),
    ("two_wheeler", True),
    ("pedestrian", True),
    ("road", False),
    ("sidewalk", False),
    ("other_ground", False),
    ("vegetation", False),
    ("building", False),
    ("traffic_facility", False),
    ("other_static", False),
)
"""Name and whether it can move by itself; coarse, so that other data sets map onto it too."""


CLASS_NAMES: Final = tuple(name for name, _ in CLASSES)


def meanings(network: str) -> tuple[ClassMeaning, ...]:
    """Meaning of each output of `salsanext` or `lmnet`."""
    if network == "lmnet":
        return tuple(ClassMeaning(name=name) for name in MOTION_CLASSES)
    return tuple(ClassMeaning(name=name, movable=movable) for name, movable in CLASSES)
