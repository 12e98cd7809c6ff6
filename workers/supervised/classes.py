"""Classes of a network's outputs, and the codes of the most probable class in an image."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import Mask
from workers.lidar.pixel_windows import argmax_code


class ClassMeaning(BaseModel):
    """One output of a network."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(min_length=1)
    movable: bool = Field(default=False, description="Can move by itself, whether or not it does.")
    moving: bool = Field(default=False, description="Moves now: the network itself tells motion.")
    ignored: bool = Field(default=False, description="Was never taught: it never wins.")


class ClassSet:
    """The classes of one network, and their codes in an image, where 0 is none.

    Args:
        classes: In the order of outputs.
    """

    def __init__(self, classes: Sequence[ClassMeaning]) -> None:
        self.classes = tuple(classes)
        self.movable: Mask = np.array([meaning.movable for meaning in classes], dtype=np.bool_)
        self.moving: Mask = np.array([meaning.moving for meaning in classes], dtype=np.bool_)
        ignored = np.array([meaning.ignored for meaning in classes], dtype=np.bool_)
        self._taught = np.flatnonzero(~ignored)
        first, last = int(self._taught[0]), int(self._taught[-1]) + 1
        in_a_row = last - first == len(self._taught)  # then no copy is made
        self._outputs = slice(first, last) if in_a_row else self._taught
        self._untaught = int(np.flatnonzero(ignored)[0]) if ignored.any() else -1

    @property
    def tells_motion(self) -> bool:
        """True if any class means moving."""
        return bool(self.moving.any())

    def best(self, probabilities: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Return the most probable class of each pixel, as a code; the first on a tie.

        Args:
            probabilities: (K, ...) of the classes.

        Returns:
            (...) one plus the rank of the class among the trained ones.
        """
        taught = np.ascontiguousarray(probabilities[self._outputs])
        return argmax_code(taught.reshape(len(taught), -1)).reshape(probabilities.shape[1:])

    def class_of(self, codes: NDArray[np.uint8]) -> NDArray[np.int16]:
        """Return the class index of each code; 0 gives the first ignored class, or -1."""
        return np.concatenate(([self._untaught], self._taught)).astype(np.int16)[codes]
