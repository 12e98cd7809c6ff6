"""Free-space votes of earlier and later frames on places: seen through, occupied or hidden."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask
from workers.free_space import FREE, OCCUPIED
from workers.points.compiled import compiled

MIN_FREE: Final = 2
"""Votes needed for free; one frame may err by a mixed pixel."""

MIN_FREE_SHARE: Final = 0.5
"""Share of the votes needed for free; a thin or leafy object is seen through only now and then."""


@dataclass(frozen=True, slots=True, eq=False)
class FreeSpaceVotes:
    """Votes of the frames on one side of an instant on V places.

    Attributes:
        free: (V,) frames that saw through the place.
        occupied: (V,) frames that saw something there.
        run: (V,) consecutive frames that saw through it, from the farthest in time; hidden frames
            do not count, and the first that saw something there ends the run.
    """

    free: NDArray[np.int16]
    occupied: NDArray[np.int16]
    run: NDArray[np.int16]

    @property
    def seen_through(self) -> Mask:
        """(V,) places that were empty, by most frames or by all but the closest in time.

        A pedestrian leaves its place after half a second: the closest frames still see it there.
        """
        mostly = self.free >= MIN_FREE_SHARE * (self.free + self.occupied)
        seen: Mask = ((self.free >= MIN_FREE) & mostly) | (self.run >= MIN_FREE)
        return seen


def votes_of(answers: list[NDArray[np.int8]], count: int) -> FreeSpaceVotes:
    """Sum the votes of the frames on one side.

    Args:
        answers: (V,) visibility codes of each frame, farthest in time first.
        count: Number of places.
    """
    free, occupied, run = np.zeros((3, count), np.int16)
    ended = np.zeros(count, np.bool_)
    for answer in answers:
        _add(answer, free, occupied, run, ended)
    return FreeSpaceVotes(free, occupied, run)


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
