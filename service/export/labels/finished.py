"""Finished labels of one frame: class, object and motion of each exported point.

A word is the class of SemanticKITTI in the lower 16 bits and the object in the upper 16.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.semantickitti import MOVABLE, MOVING, PLAIN
from service.export.frames_file import digest_of

UNKNOWN, STATIC, DYNAMIC = 0, 1, 2
"""Values of `motion` in a folder of truth."""

FIRST_MOVING: Final = 251
"""First class of SemanticKITTI that names a moving thing; 251 is that of its motion benchmark."""

OUTLIER: Final = 1
"""Class of SemanticKITTI for points that are no surface; they have no motion."""

KNOWN: Final = frozenset({0, OUTLIER, *PLAIN, *MOVABLE, *MOVING})
"""Classes of `semantic-kitti.yaml` and of its motion benchmark."""

Words = NDArray[np.uint32]


@dataclass(frozen=True, slots=True, eq=False)
class FinishedLabels:
    """Labels of one frame, in the order of its N exported points.

    Attributes:
        words: (N,) words of SemanticKITTI.
        motion: (N,) 0 unknown, 1 static, 2 dynamic.
        digest: Digest of what the file states, to compare with that of the export; empty: the
            export has no pre-labels in this form.
    """

    words: Words
    motion: NDArray[np.uint8]
    digest: str = ""

    @classmethod
    def of_words(cls, words: Words) -> "FinishedLabels":
        """Return labels whose classes name the motion, as those of SemanticKITTI do."""
        return cls(words, motion_of(words), digest_of(words))


def motion_of(words: Words) -> NDArray[np.uint8]:
    """Return (N,) 0 unknown, 1 static, 2 dynamic, as classes of SemanticKITTI name it."""
    classes = words & 0xFFFF
    motion = np.where(classes >= FIRST_MOVING, DYNAMIC, STATIC)
    return np.where(classes <= OUTLIER, UNKNOWN, motion).astype(np.uint8)


def unknown_class(words: Words) -> int | None:
    """Return a class that SemanticKITTI does not have, or None."""
    found = np.unique(words & 0xFFFF).tolist()
    return next((each for each in found if each not in KNOWN), None)
