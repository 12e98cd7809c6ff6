"""Occlusion fragments: small pieces of half-hidden movers, merged with their movers."""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.points.neighbours import build_grid, nearest_indices
from workers.points.step_names import step
from workers.selfsupervised.evidence import FreeSpaceEvidence
from workers.selfsupervised.ground_artefacts import are_ground_artefacts
from workers.selfsupervised.motion import ClusterMotions
from workers.selfsupervised.tracker import Tracked

MAX_VOXELS: Final = 60
MAX_EXTENT_M: Final = 3.0
"""Longest horizontal side of a fragment, metres: half a car."""

REACH_M: Final = 0.9
"""Largest gap between a fragment and its mover, metres.

It is half the width of a car, which separates its visible sides when the middle is hidden."""

MIN_NEAR_SHARE: Final = 0.5
_STATIC_VOTES: Final = 2.0
OCCUPIED_BEFORE_VOTES: Final = 4.0
_OCCUPIED_BEFORE_FREE_SHARE: Final = 0.1


@step("fragments")
def merge_fragments(
    points_m: Points,
    found: ClusterMotions,
    tracked: Tracked,
    evidence: FreeSpaceEvidence,
    *,
    centre_m: NDArray[np.floating],
) -> Tracked:
    """Mark small clusters close to a mover as dynamic where no evidence contradicts it.

    Args:
        points_m: (V, 3) voxel centroids off the ground, odom space.
        found: Their clusters and motions.
        tracked: Dynamic and confirmed clusters.
        evidence: Free-space evidence on the voxels.
        centre_m: (3,) the sensor, odom space.

    Returns:
        The same with those clusters as dynamic. They are also confirmed where most of their close
        neighbours are: a fragment has no stronger evidence than its mover.
    """
    clusters, votes = found.clusters, evidence.votes
    size = np.maximum(clusters.sizes, 1)
    seen = clusters.mean(votes.occupied)
    free_share = clusters.count(votes.seen_through) / size
    static = found.still & (seen > _STATIC_VOTES)
    occupied_before = (free_share < _OCCUPIED_BEFORE_FREE_SHARE) & (seen > OCCUPIED_BEFORE_VOTES)
    candidates = ~tracked.dynamic & (size <= MAX_VOXELS) & (found.extent_m <= MAX_EXTENT_M)
    candidates &= ~static & ~occupied_before
    moving = np.flatnonzero(clusters.member_mask(tracked.dynamic))
    if len(moving) == 0 or not candidates.any():
        return tracked
    members = np.flatnonzero(clusters.member_mask(candidates))
    grid = build_grid(points_m[moving], centre_m)
    nearest = nearest_indices(grid, points_m[members], REACH_M)
    neighbours = moving[grid.order[nearest[nearest >= 0]]]
    near, near_confirmed = np.zeros((2, len(points_m)), np.bool_)
    near[members[nearest >= 0]] = True
    near_confirmed[members[nearest >= 0]] = clusters.member_mask(tracked.confirmed)[neighbours]
    merged = candidates & (clusters.count(near) > MIN_NEAR_SHARE * size)
    merged &= ~are_ground_artefacts(
        points_m,
        clusters,
        merged,
        beams_from_odom=evidence.beams_from_odom,
        sensor_height_m=evidence.sensor_height_m,
    )
    of_confirmed = merged & (clusters.count(near_confirmed) > MIN_NEAR_SHARE * size)
    return replace(
        tracked,
        dynamic=tracked.dynamic | merged,
        confirmed=tracked.confirmed | of_confirmed,
    )
