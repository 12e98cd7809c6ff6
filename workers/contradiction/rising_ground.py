"""Rising ground: bare ground that appears about half a metre higher for a while, without an object.

Spray, steam over a manhole and mirroring puddles cause it, and so does a shaken sensor. It is to
the ground what a slip is to the odometry: the reference is wrong, and free space takes all of it
for motion. An object that drives over the same ground covers one place and is taller. Rising ground
covers many places at once and stays low.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform
from schemas.frame import PosedFrame
from workers.points.compiled import compiled

WITHIN_M: Final = 25.0
"""Greatest range, metres: farther out the rows of a lidar are too sparse to measure heights."""

BEYOND_M: Final = 3.0
"""Least range, metres: nearer, the car hides its own ground."""

CELL_M: Final = 0.5
AROUND_M: Final = 4.0
"""Distance from an object within which the ground is tested, metres."""

_RISES_M: Final = 0.2
"""Least rise over the ground, metres: rough roads, pitch and odometry stay below in `WITHIN_M`."""

_LOW_M: Final = 1.0
_TALL_M: Final = 1.2
"""Heights, metres: rising ground is below the first; people, cars and posts are above the second.

Between the two a cell is tested, and does not count as rising.
"""

_OBJECT_MARGIN: Final = 3
"""Cells around an object that are not tested, 1.5 m: bonnets and arms are low too."""

_BARE_SHARE: Final = 0.3
"""Least share of bare frames among those that observe a cell: a permanent object is no ground."""

_FEWEST_SEEN: Final = 3
_FEWEST_BARE: Final = 2
_USUAL_SHARE: Final = 0.3
"""Quantile of the lowest points over all frames that is the height of the ground."""

_FEWEST_TESTED: Final = 12
"""Least number of tested cells, three square metres: of fewer, some rise by chance."""

_MAX_OFFSET_M: Final = 100.0
"""Bound each way from the median position, metres: frames of a lost pose beyond it are ignored."""

_NOTHING: Final = np.float32(1e9)

Heights = NDArray[np.float32]
Cells = NDArray[np.bool_]


class RisingGround:
    """Ground of a few seconds, per cell and frame.

    A cell is tested in a frame if other frames observe it bare, and no object is next to it.
    """

    def __init__(self, frames: Sequence[PosedFrame]) -> None:
        """Compare the cells of all frames, in odom space.

        Args:
            frames: Frames of one log with healthy or doubted poses; at least one.
        """
        self._frames = frames
        at_m = np.array([posed.odom_from_sensor[:2, 3] for posed in frames])
        middle_m = np.median(at_m, axis=0)
        at_m = at_m.clip(middle_m - _MAX_OFFSET_M, middle_m + _MAX_OFFSET_M)
        self._origin_m = at_m.min(axis=0) - WITHIN_M - CELL_M
        across = np.ceil((at_m.max(axis=0) - self._origin_m + WITHIN_M) / CELL_M) + 1
        shape = (len(frames), int(across[0]), int(across[1]))
        low, high = np.full(shape, _NOTHING), np.full(shape, -_NOTHING)
        for number, posed in enumerate(frames):
            frame, pose = posed.frame, posed.odom_from_sensor
            _span(frame.points_m, frame.valid_mask, pose, self._origin_m, low[number], high[number])
        self._tested, self._rises = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
        _compare(low, high, self._tested, self._rises)

    def around(self, number: int, point_index: NDArray[np.int64]) -> tuple[int, int]:
        """Count rising and tested cells around an object, without those under it.

        Args:
            number: Index of the frame.
            point_index: (M,) points of the object.

        Returns:
            Rising cells and tested cells within 4 m.
        """
        posed = self._frames[number]
        pose = posed.odom_from_sensor
        points_m = posed.frame.points_m[point_index].astype(np.float64)
        places_m = points_m @ pose[:2, :3].T + pose[:2, 3]
        places = np.floor((places_m - self._origin_m) / CELL_M).astype(np.int64)
        reach = round(AROUND_M / CELL_M)
        first = np.maximum(places.min(axis=0) - reach, 0)
        last = np.maximum(places.max(axis=0) + reach + 1, 0)
        window = (number, slice(first[0], last[0]), slice(first[1], last[1]))
        tested, rises = self._tested[window].copy(), self._rises[window]
        _exclude(places - first, tested)
        return int((tested & rises).sum()), int(tested.sum())


def rising_share(counts: Sequence[tuple[int, int]]) -> float:
    """Return the share of rising ground around an object over its frames; near 0 for few cells.

    Args:
        counts: Counts of `RisingGround.around` for each frame.
    """
    rises = sum(each for each, _ in counts)
    tested = sum(each for _, each in counts)
    return rises / max(tested, _FEWEST_TESTED * len(counts))


@compiled
def _span(
    points: Points,
    valid: Mask,
    pose: Transform,
    origin: NDArray[np.float64],
    low: Heights,
    high: Heights,
) -> None:
    """Find the lowest and highest point of each cell in one frame, odom space."""
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        across = x * x + y * y
        if not (valid[i] and BEYOND_M * BEYOND_M < across < WITHIN_M * WITHIN_M):
            continue
        along = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3] - origin[0]
        aside = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3] - origin[1]
        a, b = int(np.floor(along / CELL_M)), int(np.floor(aside / CELL_M))
        if not (0 <= a < low.shape[0] and 0 <= b < low.shape[1]):
            continue  # the car is on its side, or astray: heights are none
        height = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        low[a, b] = min(low[a, b], height)
        high[a, b] = max(high[a, b], height)


@compiled
def _compare(low: Heights, high: Heights, tested: Cells, rises: Cells) -> None:
    """Compare each cell of each frame with its usual height; mark tested and rising cells."""
    frames, wide, deep = low.shape
    ground = np.full((wide, deep), _NOTHING)
    bare = np.zeros((wide, deep), np.bool_)
    heights = np.empty(frames, np.float32)
    for a in range(wide):
        for b in range(deep):
            seen = 0
            for f in range(frames):
                if low[f, a, b] < _NOTHING:
                    heights[seen] = low[f, a, b]
                    seen += 1
            if seen < _FEWEST_SEEN:
                continue
            ground[a, b] = np.sort(heights[:seen])[int(_USUAL_SHARE * (seen - 1))]
            times = 0
            for f in range(frames):
                times += -_NOTHING < high[f, a, b] < ground[a, b] + _RISES_M
            bare[a, b] = times >= max(_FEWEST_BARE, _BARE_SHARE * seen)
    for f in range(frames):
        for a in range(wide):
            for b in range(deep):
                if (
                    bare[a, b]
                    and low[f, a, b] < _NOTHING
                    and not _is_near_object(f, a, b, low, high, ground)
                ):
                    tested[f, a, b] = True
                    up, top = low[f, a, b] - ground[a, b], high[f, a, b] - ground[a, b]
                    rises[f, a, b] = up > _RISES_M and top < _LOW_M


@compiled
def _is_near_object(f: int, a: int, b: int, low: Heights, high: Heights, ground: Heights) -> bool:
    """Return whether an object is in a cell or close to it."""
    for i in range(max(0, a - _OBJECT_MARGIN), min(low.shape[1], a + _OBJECT_MARGIN + 1)):
        for j in range(max(0, b - _OBJECT_MARGIN), min(low.shape[2], b + _OBJECT_MARGIN + 1)):
            if low[f, i, j] < _NOTHING and high[f, i, j] > _TALL_M + min(
                ground[i, j], low[f, i, j]
            ):
                return True
    return False


@compiled
def _exclude(places: NDArray[np.int64], tested: Cells) -> None:
    """Remove the cells of an object, and their neighbours, from the tested cells."""
    for i in range(len(places)):
        for a in range(max(0, places[i, 0] - 1), min(tested.shape[0], places[i, 0] + 2)):
            for b in range(max(0, places[i, 1] - 1), min(tested.shape[1], places[i, 1] + 2)):
                tested[a, b] = False
