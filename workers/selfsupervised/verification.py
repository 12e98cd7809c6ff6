"""Motion verification: a registered motion counts only if free space confirms it."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from workers.free_space import FREE, Votes, visibility, with_views
from workers.points.clusters import Clusters
from workers.points.step_names import step
from workers.selfsupervised.candidates import LONG_M, far_candidates, near_candidates, near_hints
from workers.selfsupervised.evidence import FreeSpaceEvidence
from workers.selfsupervised.registration import RegistrationResiduals

MIN_FREE_SHARE: Final = 0.25
"""Share of a cluster that free space must confirm; .15 doubles false clusters, .40 loses movers."""

_MIN_END_SHARE: Final = 0.5
"""Share of the new place of a long cluster, or of the one it left, that free space must confirm."""

_MIN_END_VOXELS: Final = 12
"""Fewest voxels of such an end: as many as a cluster needs whose motion counts in full."""

_MAX_FREE_EXTENT_M: Final = 20.0

FLAT_M: Final = 0.25
"""Height that one beam sees of an object, metres; a lower cluster may be all of it."""


@dataclass(frozen=True, slots=True, eq=False)
class VerifiedMotions:
    """Verified motions of K clusters.

    Attributes:
        registered: (K,) registration found a motion and free space confirms it.
        seen_through: (K,) free space alone shows that its place was free before or is free after.
        unconfirmed: (K,) registration found a motion that free space does not confirm.
        velocity_m_per_s: (K, 3) over the ground, odom space; zero where none was found.
        near_velocity_m_per_s: (K, 3) by the near frame alone; zero where it shows no motion.
    """

    registered: Mask
    seen_through: Mask
    unconfirmed: Mask
    velocity_m_per_s: NDArray[np.float32]
    near_velocity_m_per_s: NDArray[np.float32]

    @property
    def dynamic(self) -> Mask:
        """(K,) clusters that at least one kind of evidence shows to move."""
        return self.registered | self.seen_through


@step("verification")
def verify_motions(
    points_m: Points,
    clusters: Clusters,
    fit: RegistrationResiduals,
    evidence: FreeSpaceEvidence,
    *,
    near_age_s: float,
    far_age_s: float,
) -> VerifiedMotions:
    """Decide which clusters move.

    Args:
        points_m: (N, 3) voxel centroids, odom space.
        clusters: Sets of them.
        fit: Their registration.
        evidence: Free-space evidence on the voxels.
        near_age_s: Age of the near reference.
        far_age_s: Age of the far reference.
    """
    velocity_far = -fit.shift_far_m / np.float32(far_age_s)
    velocity_near = -fit.shift_near_m / np.float32(near_age_s)
    far, clear = far_candidates(fit, velocity_far, velocity_near)
    near = near_candidates(fit, velocity_near) & ~far

    size = np.maximum(clusters.sizes, 1)
    seen_through = np.maximum(
        clusters.count(evidence.votes.seen_through), clusters.count(evidence.after.seen_through)
    )
    was_free = np.where(
        near, clusters.count(evidence.near >= FREE), clusters.count(evidence.far >= FREE)
    )
    shift = np.where(near[:, None], fit.shift_near_m, fit.shift_far_m)
    left_free = _left_free(points_m, clusters, far | near, shift, evidence)
    enough = MIN_FREE_SHARE * size
    once = np.maximum(np.maximum(was_free, left_free), seen_through) >= enough
    twice = np.minimum(was_free, left_free) >= enough
    candidate = far | near
    confirmed = np.where(clear | near, once, twice)
    confirmed |= clear & _ends_are_free(fit, shift, size, np.maximum(was_free, left_free))

    velocity = np.where(near[:, None], velocity_near, velocity_far)
    hinted = np.where(near_hints(fit, velocity_near)[:, None], velocity_near, 0.0)
    return VerifiedMotions(
        registered=candidate & confirmed,
        seen_through=_seen_through(points_m, clusters, fit, evidence.votes)
        | _seen_through(points_m, clusters, fit, evidence.after),
        unconfirmed=candidate & ~confirmed,
        velocity_m_per_s=np.nan_to_num(velocity).astype(np.float32),
        near_velocity_m_per_s=hinted.astype(np.float32),
    )


def _ends_are_free(
    fit: RegistrationResiduals,
    shift: NDArray[np.float32],
    size: NDArray[np.int64],
    free: NDArray[np.int64],
) -> Mask:
    """Return the long clusters whose ends free space confirms, as far as they left their place.

    A lorry of 16 m at 3 m/s leaves a tenth of its place within half a second: free space can
    confirm that tenth alone, at one of its ends.
    """
    moved_m = np.hypot(shift[:, 0], shift[:, 1])
    new_share = moved_m / np.maximum(fit.extent_m, LONG_M)
    free_enough: Mask = (
        (fit.extent_m > LONG_M)
        & (free >= _MIN_END_SHARE * new_share * size)
        & (free >= _MIN_END_VOXELS)
    )
    return free_enough


def _left_free(
    points_m: Points,
    clusters: Clusters,
    candidate: Mask,
    shift: NDArray[np.float32],
    evidence: FreeSpaceEvidence,
) -> NDArray[np.int64]:
    """Count (K,) points whose earlier place the frame itself sees through, now that they left."""
    of_member = np.repeat(np.arange(len(clusters)), clusters.sizes)
    asked = candidate[of_member]
    members, owner = clusters.members[asked], of_member[asked]
    left_m = points_m[members] + shift[owner]
    answer = visibility(left_m, evidence.beams_from_odom, evidence.image, evidence.table)
    answer = with_views(answer, left_m, evidence.views)
    return np.bincount(owner[answer >= FREE], minlength=len(clusters))


def _seen_through(
    points_m: Points, clusters: Clusters, fit: RegistrationResiduals, votes: Votes
) -> Mask:
    """Return the clusters whose place was free before or is free after, by free space alone.

    A flat object may have been there unseen, between two beams that are far apart.
    """
    size = clusters.sizes
    seen_through = np.where(
        _heights_m(points_m, clusters) < FLAT_M,
        clusters.count(votes.closely_seen_through),
        clusters.count(votes.seen_through),
    )
    known = clusters.count(votes.known)
    enough = np.minimum(5, np.maximum(3, size / 2))
    decided: Mask = (
        (seen_through >= enough)
        & (seen_through >= 0.5 * known)
        & (seen_through >= 0.15 * size)
        & (fit.extent_m < _MAX_FREE_EXTENT_M)
    )
    return decided


def _heights_m(points_m: Points, clusters: Clusters) -> NDArray[np.float32]:
    height = points_m[clusters.members, 2]
    begin = clusters.start[:-1]
    if len(begin) == 0:
        return np.zeros(0, np.float32)
    return np.maximum.reduceat(height, begin) - np.minimum.reduceat(height, begin)
