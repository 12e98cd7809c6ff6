"""Free space: visibility of places in the range images of other frames, and votes on them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform
from workers.lidar.beam_table import BeamTable
from workers.lidar.lidar_views import LidarView
from workers.lidar.spherical import (
    BLOCK,
    column_of,
    columns_of_block,
    fill_block,
    new_block,
    project_block,
    row_above,
    rows_of_steps,
)
from workers.points.compiled import compiled, inlined
from workers.points.step_names import step

FREE: Final = 1
OCCUPIED: Final = -1
HIDDEN: Final = 0
FREE_IF_TALL: Final = 2
"""Seen through between beams that are far apart: nothing taller than `WIDE_GAP_M` was there."""

WIDE_GAP_M: Final = 0.5
"""Largest gap between two beams at a place that can still be seen through, metres.

Every road user is taller, so that one of two beams this far apart hits it at any elevation: a wheel
is 0.6 m, a bonnet 0.9 m high."""

OCCUPIED_MARGIN_M: Final = 0.25
OCCUPIED_MARGIN_PER_M: Final = 0.006
FREE_MARGIN_M: Final = 0.40
FREE_MARGIN_PER_M: Final = 0.010
"""Distance behind a place from which a return shows it to be free, and its growth per metre.

At 0 m: range noise (2-3 cm), pose error (3 cm) and the depth of a surface inside a voxel, several
times over. Per metre: 0.1 degrees of yaw (1.7 mm), and the footprint of beam and cell (0.2 degrees,
3.5 mm) on a slanted surface."""

_OCCUPIED_MARGIN: Final = np.float32(OCCUPIED_MARGIN_M)
_OCCUPIED_MARGIN_PER: Final = np.float32(OCCUPIED_MARGIN_PER_M)
_FREE_MARGIN: Final = np.float32(FREE_MARGIN_M)
_FREE_MARGIN_PER: Final = np.float32(FREE_MARGIN_PER_M)
_NOTHING: Final = np.float32(0.0)

MIN_FREE_VOTES: Final = 2
MIN_FREE_SHARE: Final = 0.5


@step("free space")
def visibility(
    points_m: Points,
    sensor_from_points: Transform,
    image: NDArray[np.float32],
    table: BeamTable,
) -> NDArray[np.int8]:
    """Compute the visibility of places in one frame: FREE, OCCUPIED or HIDDEN.

    FREE_IF_TALL needs two beams with a return behind the place. They are farther apart than the
    table's widest gap, but at most 0.5 m at the place.

    A place is compared with the cells of the two beams that bracket it, three columns wide. Any
    return at its range means OCCUPIED, and any nearer one hides it. The place is FREE if all
    returns are behind it, on both beams or in three cells. Cells without return mean nothing: sky,
    glass and black paint look alike.

    Args:
        points_m: (N, 3) places, in any space.
        sensor_from_points: (4, 4) from that space to the beams' space of the frame.
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


def with_views(
    answer: NDArray[np.int8], points_m: Points, views: Sequence[LidarView]
) -> NDArray[np.int8]:
    """Join the visibility of places in one frame of the main lidar with that of further lidars.

    Every ray is cast from its own lidar. A return at a place counts more than rays beyond it, since
    lidars measure at different instants of a frame; a frame stays one vote.

    Args:
        answer: (N,) visibility codes from the main lidar.
        points_m: (N, 3) the places, in the space of the views.
        views: Views of the further lidars within that frame.

    Returns:
        (N,) int8, the same array without views.
    """
    for view in views:
        other = visibility(points_m, view.beams_from_odom, view.image, view.table)
        free = np.where((answer > 0) & (other > 0), np.minimum(answer, other), answer + other)
        occupied = (answer == OCCUPIED) | (other == OCCUPIED)
        answer = np.where(occupied, OCCUPIED, free).astype(np.int8)
    return answer


@dataclass(frozen=True, slots=True, eq=False)
class Votes:
    """Free-space votes of several frames on places.

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
        """(N,) places with at least one vote."""
        return (self.free + self.occupied) > 0

    @property
    def seen_through(self) -> Mask:
        """(N,) places with at least two free votes that are at least half of all.

        One frame may err by a mixed pixel. A thin or leafy object is seen through now and then,
        but is also seen.
        """
        return _mostly(self.free, self.occupied)

    @property
    def closely_seen_through(self) -> Mask:
        """(N,) the same for beams that are close together: even a flat object was not there."""
        return _mostly(self.free - self.free_if_tall, self.occupied)

    def __add__(self, others: "Votes") -> "Votes":
        """Add the votes of two sets of frames on the same places."""
        return Votes(
            self.free + others.free,
            self.occupied + others.occupied,
            self.free_if_tall + others.free_if_tall,
        )


def count_votes(answers: Iterable[NDArray[np.int8]], n: int) -> Votes:
    """Sum the visibility codes of several frames on the same n places."""
    free, occupied, free_if_tall = np.zeros((3, n), np.int16)
    for answer in answers:
        _add(answer, free, occupied, free_if_tall)
    return Votes(free, occupied, free_if_tall)


@compiled
def _add(
    answer: NDArray[np.int8],
    free: NDArray[np.int16],
    occupied: NDArray[np.int16],
    free_if_tall: NDArray[np.int16],
) -> None:
    for i in range(len(answer)):
        free[i] += answer[i] >= FREE
        free_if_tall[i] += answer[i] == FREE_IF_TALL
        occupied[i] += answer[i] == OCCUPIED


@compiled
def _mostly(free: NDArray[np.int16], occupied: NDArray[np.int16]) -> Mask:
    mostly = np.zeros(len(free), np.bool_)
    for i in range(len(free)):
        opinions = free[i] + occupied[i]
        mostly[i] = (free[i] >= MIN_FREE_VOTES) & (free[i] >= MIN_FREE_SHARE * opinions)
    return mostly


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
    if rows < 2:
        return answer
    block, steps = new_block(), rows_of_steps(tangents)
    for first in range(0, len(points), BLOCK):
        n = fill_block(block, points, first, pose)
        project_block(block, n, tangents, steps)
        columns_of_block(block, n, columns)
        for k in range(n):
            above = row_above(tangents, block.row[k], block.tangent[k])
            if above == 0 or above == rows:
                continue
            gap = tangents[above] - tangents[above - 1]
            wide = gap > max_gap
            if wide and gap * block.across[k] > WIDE_GAP_M:
                continue
            column = column_of(block.column[k], block.x[k], block.y[k], columns)
            answer[first + k] = _seen(image, above, column, block.distance[k], wide)
    return answer


@inlined
def _seen(
    image: NDArray[np.float32], above: int, column: int, distance: np.float32, wide: bool
) -> int:
    """Compare a place with six cells by sums of comparisons, since branches are unpredictable."""
    at = _OCCUPIED_MARGIN + _OCCUPIED_MARGIN_PER * distance
    lower, upper = image[above - 1, column], image[above, column]
    # most of the places are occupied, straight ahead
    ahead = int(lower > _NOTHING) & int(abs(lower - distance) < at)
    ahead |= int(upper > _NOTHING) & int(abs(upper - distance) < at)
    if ahead > 0:
        return OCCUPIED
    columns = image.shape[1]
    free_from = distance + (_FREE_MARGIN + _FREE_MARGIN_PER * distance)
    left = column - 1 if column > 0 else columns - 1
    right = column + 1 if column < columns - 1 else 0
    occupied, blocked, below, over = 0, 0, 0, 0
    for at_column in (left, column, right):
        lower, upper = image[above - 1, at_column], image[above, at_column]
        has_lower, has_upper = int(lower > _NOTHING), int(upper > _NOTHING)
        occupied += has_lower & int(abs(lower - distance) < at)
        occupied += has_upper & int(abs(upper - distance) < at)
        blocked += has_lower & int(lower <= free_from)
        blocked += has_upper & int(upper <= free_from)
        below += has_lower
        over += has_upper
    close = int(not wide)
    free = int(blocked == 0) & (int(below * over > 0) | (close & int(below + over > 2)))
    return free * (FREE_IF_TALL - close) if occupied == 0 else OCCUPIED
