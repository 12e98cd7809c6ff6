"""Pieces of movers: what is half hidden falls apart into clusters too small to be judged alone."""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.selfsupervised.motion import ClusterMotions
from workers.selfsupervised.neighbours import build_grid, nearest_indices
from workers.selfsupervised.tracker import Tracked
from workers.visibility.free_space import Votes
from workers.visibility.steps import step

MAX_VOXELS: Final = 60
MAX_EXTENT_M: Final = 3.0
"""A piece is smaller than the thing: half a car."""

REACH_M: Final = 0.9
"""Half the width of a car: what separates its visible sides when the middle is hidden."""

MIN_NEAR_SHARE: Final = 0.5
MIN_HEIGHT_M: Final = 0.15
"""Flatter pieces beside a mover are the road it drives on."""

_STANDS_VOTES: Final = 2.0
_WAS_THERE_VOTES: Final = 4.0
_WAS_THERE_FREE_SHARE: Final = 0.1


@step("fragments")
def fragments_of_movers(
    points_m: Points,
    found: ClusterMotions,
    tracked: Tracked,
    votes: Votes,
    *,
    centre_m: NDArray[np.floating],
) -> Tracked:
    """Find the small clusters that nothing speaks against and that lie close beside a mover.

    Args:
        points_m: (V, 3) voxel centroids off the ground, odom space.
        found: Their clusters and motions.
        tracked: Which of them move, and which are confirmed.
        votes: What free space says about the voxels.
        centre_m: (3,) the sensor, odom space.

    Returns:
        The same with those clusters: dynamic, and confirmed where most of what is close beside
        belongs to something confirmed. A piece says nothing that its mover did not.
    """
    clusters = found.clusters
    size = np.maximum(clusters.sizes, 1)
    seen = clusters.mean(votes.occupied)
    free_share = clusters.count(votes.seen_through) / size
    stands = found.still & (seen > _STANDS_VOTES)
    was_there = (free_share < _WAS_THERE_FREE_SHARE) & (seen > _WAS_THERE_VOTES)
    asked = ~tracked.dynamic & (size <= MAX_VOXELS) & (found.extent_m <= MAX_EXTENT_M)
    asked &= ~stands & ~was_there
    moving = np.flatnonzero(clusters.member_mask(tracked.dynamic))
    if len(moving) == 0 or not asked.any():
        return tracked
    members = np.flatnonzero(clusters.member_mask(asked))
    grid = build_grid(points_m[moving], centre_m)
    nearest = nearest_indices(grid, points_m[members], REACH_M)
    beside = moving[grid.order[nearest[nearest >= 0]]]
    near, near_confirmed = np.zeros((2, len(points_m)), np.bool_)
    near[members[nearest >= 0]] = True
    near_confirmed[members[nearest >= 0]] = clusters.member_mask(tracked.confirmed)[beside]
    merged = asked & (clusters.count(near) > MIN_NEAR_SHARE * size)
    for k in np.flatnonzero(merged):
        low, high = np.quantile(points_m[clusters.of(int(k)), 2], [0.03, 0.97])
        merged[k] = high - low >= MIN_HEIGHT_M
    of_confirmed = merged & (clusters.count(near_confirmed) > MIN_NEAR_SHARE * size)
    return replace(
        tracked,
        dynamic=tracked.dynamic | merged,
        confirmed=tracked.confirmed | of_confirmed,
    )
