"""Training classes of the two networks of the supervised stream."""

from typing import Final

from workers.lab.evaluation.truth.class_table import COARSE, MOVABLE
from workers.supervised.classes import ClassMeaning
from workers.supervised.lmnet import MOTION_CLASSES

CLASSES: Final[tuple[tuple[str, bool], ...]] = (
    ("unlabeled", False),
    *((name, name in MOVABLE) for name in COARSE[1:]),
)
"""Name of each class, and whether it is movable: the classes of the semantic evaluation."""

CLASS_NAMES: Final = tuple(name for name, _ in CLASSES)


def meanings(network: str) -> tuple[ClassMeaning, ...]:
    """Return the meaning of each output of `salsanext` or `lmnet`."""
    if network == "lmnet":
        return tuple(ClassMeaning(name=name) for name in MOTION_CLASSES)
    return tuple(ClassMeaning(name=name, movable=movable) for name, movable in CLASSES)
