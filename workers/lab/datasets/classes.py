"""Training classes of the two networks of the supervised stream."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from schemas.frame import LidarFrame
from workers.lab.evaluation.truth.class_table import COARSE, MOVABLE, SEMANTIC_KITTI
from workers.lab.evaluation.truth.truth import LogTruth, TruthUnusableError
from workers.supervised.classes import ClassMeaning
from workers.supervised.lmnet import MOTION_CLASSES

CLASSES: Final[tuple[tuple[str, bool], ...]] = (
    ("unlabeled", False),
    *((name, name in MOVABLE) for name in COARSE[1:]),
)
"""Name of each class, and whether it is movable: the classes of the semantic evaluation."""

CLASS_NAMES: Final = tuple(name for name, _ in CLASSES)

_KITTI_MOVABLE: Final = range(1, 9)
"""Numbers of SemanticKITTI's classes that can move."""


def meanings(network: str) -> tuple[ClassMeaning, ...]:
    """Return the meaning of each output of `salsanext` or `lmnet`."""
    if network == "lmnet":
        return tuple(ClassMeaning(name=name) for name in MOTION_CLASSES)
    return tuple(ClassMeaning(name=name, movable=movable) for name, movable in CLASSES)


@dataclass(frozen=True, slots=True)
class ClassTable:
    """Classes that a semantic network is taught, and how truth states them.

    Attributes:
        meanings: Meaning of each output; the first is never taught.
        own: Output of each id of the array `semantic`, 0 for those not taught; empty: classes are
            the numbers of `semantic19`; None: the coarse classes of the evaluation.
    """

    meanings: tuple[ClassMeaning, ...] = field(default_factory=lambda: meanings("salsanext"))
    own: Mapping[int, int] | None = None

    @classmethod
    def own_of(cls, truth: Path) -> Self:
        """Read the classes of a folder of truth, each its own: `classes.json` in that folder.

        Raises:
            TruthUnusableError: If the file is missing or is no table of classes.
        """
        path = truth / "classes.json"
        try:
            rows = json.loads(path.read_text(encoding="utf-8"))["classes"]
            listed = [
                (int(row["id"]), str(row["name"]), int(row["semantickitti19"])) for row in rows
            ]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise TruthUnusableError(
                f"own classes need a classes.json as deploy/TRUTH.md defines it, with id, name and "
                f"semantickitti19 of each ({path})"
            ) from error
        taught = [(number, name, kitti) for number, name, kitti in listed if kitti]
        if not taught or any(not 0 <= number < 256 for number, _, _ in listed):
            raise TruthUnusableError(
                f"classes.json needs ids from 0 to 255, and one class that is not 0 ({path})"
            )
        return cls(
            (
                ClassMeaning(name="unlabeled"),
                *(
                    ClassMeaning(name=name, movable=kitti in _KITTI_MOVABLE)
                    for _, name, kitti in taught
                ),
            ),
            dict.fromkeys((number for number, _, _ in listed), 0)
            | {number: output for output, (number, _, _) in enumerate(taught, start=1)},
        )

    @classmethod
    def semantickitti(cls) -> Self:
        """Return the classes of SemanticKITTI, as truth states them in `semantic19`."""
        return cls(
            tuple(
                ClassMeaning(name=name, movable=number in _KITTI_MOVABLE)
                for number, name in enumerate(SEMANTIC_KITTI)
            ),
            {},
        )

    def of(self, truth: LogTruth, frame: LidarFrame, *, number: int) -> NDArray[np.uint8]:
        """Return (N,) the taught class of each point of a frame; 0 where truth has none.

        Raises:
            TruthUnusableError: If truth labels another number of points, or uses an unknown id.
        """
        nothing = np.zeros(len(frame), dtype=np.uint8)
        if self.own is None:
            known = truth.classes_of(frame, number=number)
            return nothing if known is None else known
        name = "semantic" if self.own else "semantic19"
        ids = truth.ids_of(frame, number=number, name=name)
        if ids is None:
            return nothing
        if not self.own:
            return ids
        if unknown := sorted(set(np.unique(ids).tolist()) - set(self.own)):
            raise TruthUnusableError(
                f"the truth of frame {number} has the class id {unknown[0]}, which its "
                f"classes.json does not list ({frame.log_id})"
            )
        table = np.zeros(256, dtype=np.uint8)
        table[list(self.own)] = list(self.own.values())
        outputs: NDArray[np.uint8] = table[ids]
        return outputs
