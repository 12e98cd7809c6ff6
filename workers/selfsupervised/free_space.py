"""The free-space witness: was a place seen through, or was something there?"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform
from workers.selfsupervised.beam_table import BeamTable
from workers.selfsupervised.compiled import compiled
from workers.selfsupervised.range_image import column_of, guessed_row_above, row_guesses
from workers.selfsupervised.steps import step

FREE: Final = 1
OCCUPIED: Final = -1
HIDDEN: Final = 0
FREE_IF_TALL: Final = 2
"""Seen through between beams that are far apart: nothing taller than `WIDE_GAP_M` was there."""

WIDE_GAP_M: Final = 0.5
"""Whatever takes part in traffic is taller, so that one of two beams this far apart hits it at
whatever angle they are: a wheel is 0.6 m, a bonnet 0.9 m high."""

OCCUPIED_MARGIN_M: Final = 0.25
OCCUPIED_MARGIN_PER_M: Final = 0.006
FREE_MARGIN_M: Final = 0.40
FREE_MARGIN_PER_M: Final = 0.010
"""A return this much behind a place proves it free.

At 0 m: range noise (2-3 cm), pose error (3 cm) and the depth of a surface inside a voxel, several
times over. Per metre: 0.1 degrees of yaw (1.7 mm), and the footprint of beam and cell (0.2 degrees,
3.5 mm) on a slanted surface."""

MIN_FREE_VOTES: Final = 2
MIN_FREE_SHARE: Final = 0.5


@step("free space")
def visibility(
    points_m: Points,
    sensor_from_points: Transform,
    image: NDArray[np.float32],
    table: BeamTable,
) -> NDArray[np.int8]:
    """Ask one frame about places: FREE (seen through), OCCUPIED (something there) or HIDDEN.

    Where the two beams are farther apart than the table's widest gap, but not farther than 0.5 m
    at the place, and both came back from beyond, the answer is FREE_IF_TALL.

    A place is compared with the cells of the two beams that bracket it, three columns wide. Any
    return at its range says OCCUPIED, any nearer one hides it, and if all that came back lies
    beyond, from both beams or in three cells, the place was FREE. Cells without return say
    nothing: sky, glass and black paint look alike.

    Args:
        points_m: (N, 3) places, in any space.
        sensor_from_points: (4, 4) from that space to the beams' space of the frame asked.
        image: (R, C) range image of that frame.
        table: Its beams.

    Returns:
        (N,) int8.
    """
    return _visibility(
        points_m,
        sensor_from_points[:3].astype(np.float32),
        image,
        table.tangents,
        np.float32(table.max_gap),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Votes:
    """What the frames of the last second say about places.

    Attributes:
        free: (N,) frames that saw through the place.
        occupied: (N,) frames that saw something there.
        free_if_tall: (N,) those of `free` whose beams passed it far apart.
    """

    free: NDArray[np.int16]
    occupied: NDArray[np.int16]

    free_if_tall: NDArray[np.int16]

    @property
    def known(self) -> Mask:
        """(N,) places that any frame has an opinion on."""
        return (self.free + self.occupied) > 0

    @property
    def seen_through(self) -> Mask:
        """(N,) places that were free before: twice, and in half of the opinions at least.

        One frame may err by a mixed pixel; a thin or leafy thing is seen through now and then
        but is seen as well.
        """
        return _mostly(self.free, self.occupied)

    @property
    def closely_seen_through(self) -> Mask:
        """(N,) the same by beams that are close together: even a flat thing was not there."""
        return _mostly(self.free - self.free_if_tall, self.occupied)


def _mostly(free: NDArray[np.int16], occupied: NDArray[np.int16]) -> Mask:
    return (free >= MIN_FREE_VOTES) & (free >= MIN_FREE_SHARE * (free + occupied))


def count_votes(answers: Iterable[NDArray[np.int8]], n: int) -> Votes:
    """Sum the answers of several frames about the same n places."""
    free, occupied, free_if_tall = np.zeros((3, n), np.int16)
    for answer in answers:
        free += answer >= FREE
        free_if_tall += answer == FREE_IF_TALL
        occupied += answer == OCCUPIED
    return Votes(free, occupied, free_if_tall)


@compiled
def _visibility(
    points: Points,
    pose: NDArray[np.float32],
    image: NDArray[np.float32],
    tangents: NDArray[np.float32],
    max_gap: np.float32,
) -> NDArray[np.int8]:
    rows, columns = image.shape
    answer = np.zeros(len(points), np.int8)
    guesses = row_guesses(tangents)
    for i in range(len(points)):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        x = pose[0, 0] * px + pose[0, 1] * py + pose[0, 2] * pz + pose[0, 3]
        y = pose[1, 0] * px + pose[1, 1] * py + pose[1, 2] * pz + pose[1, 3]
        z = pose[2, 0] * px + pose[2, 1] * py + pose[2, 2] * pz + pose[2, 3]
        across = np.sqrt(x * x + y * y)
        distance = np.sqrt(x * x + y * y + z * z)
        tangent = z / max(across, np.float32(1e-3))
        above = guessed_row_above(tangents, guesses, tangent)
        if above == 0 or above == rows:
            continue
        gap = tangents[above] - tangents[above - 1]
        wide = gap > max_gap
        if wide and gap * across > WIDE_GAP_M:
            continue
        column = column_of(x, y, columns)
        at = OCCUPIED_MARGIN_M + OCCUPIED_MARGIN_PER_M * distance
        free_from = distance + (FREE_MARGIN_M + FREE_MARGIN_PER_M * distance)
        left = column - 1 if column > 0 else columns - 1
        right = column + 1 if column < columns - 1 else 0
        # sums of comparisons instead of branches, which no processor can foresee here
        occupied, blocked, below, over = 0, 0, 0, 0
        for at_column in (left, column, right):
            lower, upper = image[above - 1, at_column], image[above, at_column]
            has_lower, has_upper = int(lower != 0.0), int(upper != 0.0)
            occupied += has_lower & int(abs(lower - distance) < at)
            occupied += has_upper & int(abs(upper - distance) < at)
            blocked += has_lower & int(lower <= free_from)
            blocked += has_upper & int(upper <= free_from)
            below += has_lower
            over += has_upper
        if occupied > 0:
            answer[i] = OCCUPIED
        elif blocked == 0 and min(below, over) > 0:
            answer[i] = FREE_IF_TALL if wide else FREE
        elif blocked == 0 and not wide and below + over > 2:
            answer[i] = FREE
    return answer
