"""What frames before and after say about places: which were seen through, which were taken."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask
from workers.free_space import FREE, OCCUPIED
from workers.points.compiled import compiled

MIN_FREE: Final = 2
"""One frame may err by a mixed pixel."""

MIN_FREE_SHARE: Final = 0.5
"""A thin or leafy thing is seen through now and then, but is seen as well."""


@dataclass(frozen=True, slots=True, eq=False)
class Opinions:
    """What the frames on one side of an instant say about V places.

    Attributes:
        free: (V,) frames that saw through the place.
        occupied: (V,) frames that saw something there.
        run: (V,) of those farthest in time, how many in a row saw through it; hidden ones do not
            count, the first that saw something there ends it.
    """

    free: NDArray[np.int16]
    occupied: NDArray[np.int16]
    run: NDArray[np.int16]

    @property
    def seen_through(self) -> Mask:
        """(V,) places where nothing was: by most frames, or by all but the closest in time.

        What walks leaves its place after half a second: the closest frames still see it there.
        """
        mostly = self.free >= MIN_FREE_SHARE * (self.free + self.occupied)
        seen: Mask = ((self.free >= MIN_FREE) & mostly) | (self.run >= MIN_FREE)
        return seen


def opinions_of(answers: list[NDArray[np.int8]], count: int) -> Opinions:
    """Sum up the answers of the frames on one side.

    Args:
        answers: (V,) each, farthest in time first.
        count: How many places.
    """
    free, occupied, run = np.zeros((3, count), np.int16)
    ended = np.zeros(count, np.bool_)
    for answer in answers:
        _add(answer, free, occupied, run, ended)
    return Opinions(free, occupied, run)


@compiled
def _add(
    answer: NDArray[np.int8],
    free: NDArray[np.int16],
    occupied: NDArray[np.int16],
    run: NDArray[np.int16],
    ended: Mask,
) -> None:
    for i in range(len(answer)):
        if answer[i] >= FREE:
            free[i] += 1
            run[i] += not ended[i]
        elif answer[i] == OCCUPIED:
            occupied[i] += 1
            ended[i] = True
