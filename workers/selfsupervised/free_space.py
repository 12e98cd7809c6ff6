"""The free-space witness: was a place seen through, or was something there?"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform
from workers.selfsupervised.beam_table import BeamTable
from workers.selfsupervised.compiled import compiled
from workers.selfsupervised.range_image import column_of, row_above

FREE: Final = 1
OCCUPIED: Final = -1
HIDDEN: Final = 0

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


def visibility(
    points_m: Points,
    sensor_from_points: Transform,
    image: NDArray[np.float32],
    table: BeamTable,
) -> NDArray[np.int8]:
    """Ask one frame about places: FREE (seen through), OCCUPIED (something there) or HIDDEN.

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
    """

    free: NDArray[np.int16]
    occupied: NDArray[np.int16]

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
        enough = self.free >= MIN_FREE_VOTES
        return enough & (self.free >= MIN_FREE_SHARE * (self.free + self.occupied))


def count_votes(answers: Iterable[NDArray[np.int8]], n: int) -> Votes:
    """Sum the answers of several frames about the same n places."""
    free = np.zeros(n, np.int16)
    occupied = np.zeros(n, np.int16)
    for answer in answers:
        free += answer == FREE
        occupied += answer == OCCUPIED
    return Votes(free, occupied)


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
    for i in range(len(points)):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        x = pose[0, 0] * px + pose[0, 1] * py + pose[0, 2] * pz + pose[0, 3]
        y = pose[1, 0] * px + pose[1, 1] * py + pose[1, 2] * pz + pose[1, 3]
        z = pose[2, 0] * px + pose[2, 1] * py + pose[2, 2] * pz + pose[2, 3]
        across = np.sqrt(x * x + y * y)
        distance = np.sqrt(x * x + y * y + z * z)
        tangent = z / max(across, np.float32(1e-3))
        above = row_above(tangents, tangent)
        if above == 0 or above == rows or tangents[above] - tangents[above - 1] > max_gap:
            continue
        column = column_of(x, y, columns)
        at = OCCUPIED_MARGIN_M + OCCUPIED_MARGIN_PER_M * distance
        beyond = FREE_MARGIN_M + FREE_MARGIN_PER_M * distance
        occupied, nearer, unclear = False, False, False
        filled_below, filled_above = 0, 0
        for row in range(above - 1, above + 1):
            for step in range(-1, 2):
                seen = image[row, (column + step + columns) % columns]
                if seen == 0.0:
                    continue
                if abs(seen - distance) < at:
                    occupied = True
                elif seen < distance:
                    nearer = True
                elif seen <= distance + beyond:
                    unclear = True
                if row == above:
                    filled_above += 1
                else:
                    filled_below += 1
        filled = filled_below + filled_above
        if occupied:
            answer[i] = OCCUPIED
        elif not nearer and not unclear and (min(filled_below, filled_above) > 0 or filled > 2):
            answer[i] = FREE
    return answer
