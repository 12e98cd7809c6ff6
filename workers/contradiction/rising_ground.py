"""Where the ground itself rises: bare before and after, half a metre up, and nothing stands there.

Spray, steam over a manhole and puddles that mirror do that, and so does a sensor that is shaken. It
is to the ground what a slip is to the odometry: not what stands there is wrong, but what it stands
on, and free space takes all of it for motion. A thing that drives over the same ground covers one
place and towers over it; ground that rises does so in many places at once, and stays low.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform
from schemas.frame import PosedFrame
from workers.points.compiled import compiled

WITHIN_M: Final = 25.0
"""Farther out the rows of a lidar lie too far apart to say how high a thing is."""

BEYOND_M: Final = 3.0
"""Nearer, the car hides its own ground."""

CELL_M: Final = 0.5
AROUND_M: Final = 4.0
"""From a thing, in which the ground is asked."""

_RISES_M: Final = 0.2
"""Over its own height: rough roads, pitch and odometry leave less within `WITHIN_M`."""

_LOW_M: Final = 1.0
_TALL_M: Final = 1.2
"""What stands, stands higher: people, cars, posts. Between the two nothing is said."""

_BESIDE: Final = 3
"""Cells about what stands, 1.5 m: bonnets and arms are low as well."""

_BARE_SHARE: Final = 0.3
"""Of the frames that see a place, those that see it bare: what always lies there is no ground."""

_FEWEST_SEEN: Final = 3
_FEWEST_BARE: Final = 2
_USUAL_SHARE: Final = 0.3
"""Which of the lowest points of all frames is the height of the ground, counted from below."""

_FEWEST_ASKED: Final = 12
"""Cells: of three square metres some may rise by chance."""

_ASTRAY_M: Final = 100.0
"""Each way from the middle of the frames; what a lost pose puts farther off is not asked."""

_NOTHING: Final = np.float32(1e9)

Heights = NDArray[np.float32]
Cells = NDArray[np.bool_]


class RisingGround:
    """The ground of a few seconds, cell by cell and frame by frame.

    A cell is asked in a frame if it was seen bare in others, and nothing that stands is beside it.
    """

    def __init__(self, frames: Sequence[PosedFrame]) -> None:
        """Lay the frames over each other, in odom space.

        Args:
            frames: Of one log, poses that may be believed or not; at least one.
        """
        self._frames = frames
        at_m = np.array([posed.odom_from_sensor[:2, 3] for posed in frames])
        middle_m = np.median(at_m, axis=0)
        at_m = at_m.clip(middle_m - _ASTRAY_M, middle_m + _ASTRAY_M)
        self._origin_m = at_m.min(axis=0) - WITHIN_M - CELL_M
        across = np.ceil((at_m.max(axis=0) - self._origin_m + WITHIN_M) / CELL_M) + 1
        shape = (len(frames), int(across[0]), int(across[1]))
        low, high = np.full(shape, _NOTHING), np.full(shape, -_NOTHING)
        for number, posed in enumerate(frames):
            frame, pose = posed.frame, posed.odom_from_sensor
            _span(frame.points_m, frame.valid_mask, pose, self._origin_m, low[number], high[number])
        self._asked, self._rises = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
        _compare(low, high, self._asked, self._rises)

    def around(self, number: int, point_index: NDArray[np.int64]) -> tuple[int, int]:
        """Ask the ground about a thing, but not what lies under it.

        Args:
            number: Of the frame.
            point_index: (M,) the points of the thing.

        Returns:
            Cells within 4 m of it that rise, and those that were asked.
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
        asked, rises = self._asked[window].copy(), self._rises[window]
        _leave_out(places - first, asked)
        return int((asked & rises).sum()), int(asked.sum())


def share_of(told: Sequence[tuple[int, int]]) -> float:
    """Share of the ground around a thing that rises, over its frames; 0 where nearly none is seen.

    Args:
        told: What `RisingGround.around` says of each frame.
    """
    rises = sum(each for each, _ in told)
    asked = sum(each for _, each in told)
    return rises / max(asked, _FEWEST_ASKED * len(told))


@compiled
def _span(
    points: Points,
    valid: Mask,
    pose: Transform,
    origin: NDArray[np.float64],
    low: Heights,
    high: Heights,
) -> None:
    """Find the lowest and the highest point over each cell, in one frame."""
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
def _compare(low: Heights, high: Heights, asked: Cells, rises: Cells) -> None:
    """Compare each cell in each frame with what it usually is."""
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
                    and not _beside(f, a, b, low, high, ground)
                ):
                    asked[f, a, b] = True
                    up, top = low[f, a, b] - ground[a, b], high[f, a, b] - ground[a, b]
                    rises[f, a, b] = up > _RISES_M and top < _LOW_M


@compiled
def _beside(f: int, a: int, b: int, low: Heights, high: Heights, ground: Heights) -> bool:
    """Whether something stands in a cell or close to it."""
    for i in range(max(0, a - _BESIDE), min(low.shape[1], a + _BESIDE + 1)):
        for j in range(max(0, b - _BESIDE), min(low.shape[2], b + _BESIDE + 1)):
            if low[f, i, j] < _NOTHING and high[f, i, j] > _TALL_M + min(
                ground[i, j], low[f, i, j]
            ):
                return True
    return False


@compiled
def _leave_out(places: NDArray[np.int64], asked: Cells) -> None:
    """Take the cells of a thing, and those that touch them, from those that are asked."""
    for i in range(len(places)):
        for a in range(max(0, places[i, 0] - 1), min(asked.shape[0], places[i, 0] + 2)):
            for b in range(max(0, places[i, 1] - 1), min(asked.shape[1], places[i, 1] + 2)):
                asked[a, b] = False
