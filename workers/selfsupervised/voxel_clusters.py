"""Voxel clusters by connected components, and the parts of them that are new."""

from typing import Final

import numpy as np

from schemas.arrays import Mask, Points
from workers.points.clusters import Clusters, connected, from_labels
from workers.points.neighbours import is_alone
from workers.points.step_names import step
from workers.selfsupervised.evidence import FreeSpaceEvidence
from workers.selfsupervised.registration import Reference, RegistrationResiduals

REACH_M: Final = 0.5
"""Largest gap within a cluster, metres: beams of 0.3 degrees up to 80 m; .4 to .7 give the same."""

CLOSE_REACH_M: Final = 0.3
SPLIT_REACH_M: Final = 0.4
MIN_VOXELS: Final = 3
_MIXED_FREE: Final = 8
_MIXED_SHARE: Final = 0.6
_SPLIT_VOXELS: Final = 15
_SPLIT_EXTENT_M: Final = 1.0
_CHILD_VOXELS: Final = 8
_CHILD_SHARE: Final = 0.9
_NEW_M: Final = 0.2


@step("clusters")
def find_clusters(points_m: Points, evidence: FreeSpaceEvidence) -> Clusters:
    """Cluster the voxels, with a smaller gap where a cluster seems to mix movers and others."""
    clusters = connected(points_m, reach_m=REACH_M, min_points=MIN_VOXELS)
    free, known = clusters.count(evidence.seen_through), clusters.count(evidence.votes.known)
    mixed = (free >= _MIXED_FREE) & (free < _MIXED_SHARE * known)
    if not mixed.any():
        return clusters
    again = clusters.member_mask(mixed)
    closer = connected(
        points_m,
        reach_m=CLOSE_REACH_M,
        min_points=MIN_VOXELS,
        among=again,
        groups=clusters.of_point,
    )
    labels = clusters.of_point.copy()
    labels[again] = np.where(
        closer.of_point[again] >= 0, closer.of_point[again] + len(clusters), -1
    )
    return from_labels(labels)


@step("parts")
def find_parts(
    points_m: Points,
    clusters: Clusters,
    fit: RegistrationResiduals,
    decided: Mask,
    far: Reference,
    evidence: FreeSpaceEvidence,
) -> Clusters:
    """Find parts of undecided clusters that were not there half a second ago.

    A cyclist next to a parked car forms one cluster with it, which is static as a whole.
    """
    whole = ~decided & (clusters.sizes >= _SPLIT_VOXELS) & (fit.extent_m > _SPLIT_EXTENT_M)
    asked = np.flatnonzero(clusters.member_mask(whole))
    is_new = is_alone(far.grid, points_m[asked], np.float32(_NEW_M))
    among = np.zeros(len(points_m), np.bool_)
    among[asked] = is_new | evidence.seen_through[asked]
    parts = connected(
        points_m,
        reach_m=SPLIT_REACH_M,
        min_points=_CHILD_VOXELS,
        among=among,
        groups=clusters.of_point,
    )
    parent_sizes = clusters.sizes[clusters.of_point[parts.members[parts.start[:-1]]]]
    return parts.keep(parts.sizes < _CHILD_SHARE * parent_sizes)
