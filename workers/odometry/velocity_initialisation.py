"""Velocity initialisation: sensor speeds that two frames allow, and free space against them."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Points
from schemas.frame import LidarFrame, PosedFrame
from workers.free_space import FREE, OCCUPIED, visibility
from workers.lidar.beam_table import BeamTable
from workers.lidar.deskew import Twist, twist
from workers.lidar.preprocessing import PreprocessedFrame, Preprocessor
from workers.points.se3 import inverse, transform
from workers.points.voxels import voxelize

FASTEST_M_PER_S: Final = 50.0
NEAR_M: Final = 60.0
_FEWEST: Final = 100
"""Places needed for a result."""

_PLACE_M: Final = 0.5
"""Cell of one vote, metres: near cars have many points and few cells."""

_CELL_M: Final = 0.25
_SAMPLES: Final = 1500
_LEAST_EXPLAINED: Final = 9
"""Shifts at which a single place is found again, a cell and its eight neighbours being one."""

_PEAKS: Final = 4
_PEAK_CELLS: Final = 3
_PEAK: Final = 0.75
"""Ratio of a peak's votes to the best one's.

The true speed had .87 and more on simulated motorways; in towns every other one had .6 at most."""


def candidate_velocities(first: LidarFrame, second: LidarFrame) -> list[Twist]:
    """Estimate how the sensor may have moved between two frames, at any yaw of its axes.

    Every place of the second frame votes for the shifts that move it onto something of the first,
    and splits its one vote among them. A rail or a noise wall overlaps itself at most shifts, so it
    adds almost nothing to each; a post adds almost a whole vote. The speed of static structure
    wins, or that of a queue of cars; several may be close to the best.

    Args:
        first: A frame.
        second: The one after it.

    Returns:
        (6,) each, a twist without rotation per second in the space of the sensor; best first.
    """
    prepare = Preprocessor()
    seen = [prepare(frame, np.eye(4), None) for frame in (first, second)]
    if seen[0] is None or seen[1] is None:
        return []
    before, after = (_near(each.voxels.centroids_m, each) for each in seen if each is not None)
    after = voxelize(after, voxel_m=_PLACE_M).centroids_m
    if min(len(before), len(after)) < _FEWEST:
        return []
    dt_s = (second.stamp_ns - first.stamp_ns) / NS_PER_S
    reach = int(np.ceil(FASTEST_M_PER_S * dt_s / _CELL_M))
    votes = _votes(before, after[:: max(1, len(after) // _SAMPLES)], reach)
    best, found = float(votes.max()), list[Twist]()
    while len(found) < _PEAKS and float(votes.max()) > _PEAK * best:
        x, y = (int(each) for each in np.unravel_index(votes.argmax(), votes.shape))
        shift_m = np.array([x - reach, y - reach]) * _CELL_M
        found.append(np.array([0.0, 0.0, 0.0, *(shift_m / dt_s), 0.0]))
        around = slice(max(x - _PEAK_CELLS, 0), x + _PEAK_CELLS + 1)
        votes[around, max(y - _PEAK_CELLS, 0) : y + _PEAK_CELLS + 1] = 0.0
    return found


def contradicted_share(posed: Sequence[PosedFrame]) -> float:
    """Compute the share of static places that the first or last frame finds to be free.

    The base is the places off the ground that the other of the two frames observes; the share is
    those that it sees through. Only moving objects are, if the poses are right.

    Args:
        posed: Consecutive frames, at least two.

    Returns:
        0 to 1; NaN where the two frames observe too little of each other.
    """
    prepare = Preprocessor()
    seen = [prepare(each.frame, each.odom_from_sensor, velocity) for each, velocity in _ends(posed)]
    table = prepare.table
    if seen[0] is None or seen[1] is None or table is None or not table.trusted:
        return float("nan")
    answers = np.concatenate(
        [_visibility_in(seen[0], seen[1], table), _visibility_in(seen[1], seen[0], table)]
    )
    free, occupied = int((answers >= FREE).sum()), int((answers == OCCUPIED).sum())
    return free / (free + occupied) if free + occupied >= _FEWEST else float("nan")


def _ends(posed: Sequence[PosedFrame]) -> list[tuple[PosedFrame, Twist]]:
    """Return the first and last frame, and the twist of the sensor at each, per second."""
    ends = []
    for each, earlier, later in ((posed[0], *posed[:2]), (posed[-1], *posed[-2:])):
        moved = twist(inverse(earlier.odom_from_sensor) @ later.odom_from_sensor)
        ends.append((each, moved * NS_PER_S / (later.frame.stamp_ns - earlier.frame.stamp_ns)))
    return ends


def _visibility_in(
    of: PreprocessedFrame, other: PreprocessedFrame, table: BeamTable
) -> NDArray[np.int8]:
    """Return the visibility of one frame's places in the other frame."""
    places = voxelize(_near(of.voxels.centroids_m, of), voxel_m=_PLACE_M).centroids_m
    odom_m = transform(of.odom_from_beams, places.astype(np.float64)).astype(np.float32)
    return visibility(odom_m, other.beams_from_odom, other.image, table)


def _near(places_m: Points, seen: PreprocessedFrame) -> Points:
    """Select places near a frame, in the space of its beams, so voxels do not depend on poses."""
    about = transform(seen.beams_from_odom, places_m.astype(np.float64)).astype(np.float32)
    return about[about[:, 0] ** 2 + about[:, 1] ** 2 < NEAR_M**2]


def _votes(before: Points, after: Points, reach: int) -> NDArray[np.float64]:
    """Count the votes for every shift up to `reach` cells; (2 reach + 1, same)."""
    low = np.array([-NEAR_M, -NEAR_M, min(before[:, 2].min(), after[:, 2].min())])
    low -= [(reach + 1) * _CELL_M, (reach + 1) * _CELL_M, 0.0]
    cell_m = np.array([_CELL_M, _CELL_M, _PLACE_M])
    mine, theirs = (((each - low) / cell_m).astype(np.int64) for each in (after, before))
    wide = int(2 * NEAR_M / _CELL_M) + 2 * reach + 4
    taken = np.zeros((max(mine[:, 2].max(), theirs[:, 2].max()) + 1, wide, wide), np.bool_)
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            taken[theirs[:, 2], theirs[:, 0] + dx, theirs[:, 1] + dy] = True
    shifts = np.arange(-reach, reach + 1)
    by_shift = (shifts[:, None] * wide + shifts[None]).reshape(-1, 1)
    own = (mine[:, 2] * wide + mine[:, 0]) * wide + mine[:, 1]
    met = taken.ravel()[own[None] + by_shift]
    weight = 1.0 / np.maximum(met.sum(axis=0), _LEAST_EXPLAINED)
    votes: NDArray[np.float64] = (met @ weight).reshape(len(shifts), len(shifts))
    return votes
