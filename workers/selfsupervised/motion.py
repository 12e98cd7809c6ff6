"""The motion of every cluster of a frame: clustering, registration, verification, splitting."""

from dataclasses import dataclass, replace
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from workers.points.clusters import Clusters, from_labels
from workers.points.step_names import step
from workers.selfsupervised.candidates import GOOD_FIT_NEAR_M, same_velocity
from workers.selfsupervised.evidence import FreeSpaceEvidence
from workers.selfsupervised.ground_artefacts import are_ground_artefacts
from workers.selfsupervised.registration import STILL_M, Reference, RegistrationResiduals, register
from workers.selfsupervised.verification import VerifiedMotions, verify_motions
from workers.selfsupervised.voxel_clusters import find_clusters, find_parts

_CHILD_FREE_VOXELS: Final = 12
_CHILD_FREE_ENERGY_M: Final = 0.3

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True, slots=True, eq=False)
class ClusterMotions:
    """The clusters of a frame and their motions.

    Attributes:
        clusters: Sets of voxels.
        registered: (K,) a motion was found and free space confirms it.
        seen_through: (K,) free space alone shows that its place was free before or is free after.
        unconfirmed: (K,) a motion was found that free space does not confirm.
        still: (K,) the cluster fits its present place half a second ago.
        velocity_m_per_s: (K, 3) over the ground, odom space, as registered, confirmed or not.
        near_velocity_m_per_s: (K, 3) by the near frame alone; zero where it shows no motion.
        extent_m: (K,) longest horizontal side.
    """

    clusters: Clusters
    registered: Mask
    seen_through: Mask
    unconfirmed: Mask
    still: Mask
    velocity_m_per_s: NDArray[np.float32]
    near_velocity_m_per_s: NDArray[np.float32]
    extent_m: NDArray[np.float32]

    @property
    def dynamic_now(self) -> Mask:
        """(K,) clusters that at least one kind of evidence in this frame shows to move."""
        return self.registered | self.seen_through


def find_motions(
    points_m: Points, near: Reference, far: Reference, evidence: FreeSpaceEvidence
) -> ClusterMotions:
    """Find the moving clusters among the voxels of a frame.

    Args:
        points_m: (V, 3) voxel centroids off the ground, odom space.
        near: The frame about 0.1 s ago.
        far: The frame about 0.5 s ago.
        evidence: Free-space evidence on the voxels.
    """
    clusters = find_clusters(points_m, evidence)
    fit = register(points_m, clusters, near, far)
    ages = {"near_age_s": near.age_s, "far_age_s": far.age_s}
    motions = verify_motions(points_m, clusters, fit, evidence, **ages)

    parts = find_parts(points_m, clusters, fit, motions.dynamic, far, evidence)
    part_fit = register(points_m, parts, near, far)
    part_motions = verify_motions(points_m, parts, part_fit, evidence, **ages)
    certain = (part_motions.registered & (part_fit.energy_far < GOOD_FIT_NEAR_M)) | (
        part_motions.seen_through
        & (part_fit.still_energy_far >= _CHILD_FREE_ENERGY_M)
        & (parts.sizes >= _CHILD_FREE_VOXELS)
    )
    motions, certain = _confirm_by_parts(clusters, motions, parts, part_motions, certain)
    whole = _joined(clusters, fit, motions, parts, part_fit, part_motions, certain)
    return _without_ground_artefacts(points_m, whole, evidence)


def _confirm_by_parts(
    clusters: Clusters,
    motions: VerifiedMotions,
    parts: Clusters,
    part_motions: VerifiedMotions,
    certain: Mask,
) -> tuple[VerifiedMotions, Mask]:
    """Confirm the motion of a cluster by a certain part that moves alike, and keep it whole.

    The part that was not there before is the end of a long body at which free space shows that it
    moves.

    Returns:
        The motions, and (P,) certain parts of the other clusters.
    """
    parent = clusters.of_point[parts.members[parts.start[:-1]]]
    velocity = motions.velocity_m_per_s[parent]
    alike = certain & part_motions.registered & motions.unconfirmed[parent]
    alike &= same_velocity(part_motions.velocity_m_per_s, velocity)
    confirmed = np.zeros(len(clusters), np.bool_)
    confirmed[parent[alike]] = True
    return (
        replace(
            motions,
            registered=motions.registered | confirmed,
            unconfirmed=motions.unconfirmed & ~confirmed,
        ),
        certain & ~confirmed[parent],
    )


@step("joining")
def _joined(
    clusters: Clusters,
    fit: RegistrationResiduals,
    motions: VerifiedMotions,
    parts: Clusters,
    part_fit: RegistrationResiduals,
    part_motions: VerifiedMotions,
    certain: Mask,
) -> ClusterMotions:
    """Remove certain parts from their clusters and append them as clusters of their own."""
    labels = clusters.of_point.copy()
    kept = np.flatnonzero(certain)
    for number, part in enumerate(kept.tolist()):
        labels[parts.of(part)] = len(clusters) + number
    present = np.unique(labels[labels >= 0])

    def both(own: NDArray[Scalar], of_parts: NDArray[Scalar]) -> NDArray[Scalar]:
        return np.concatenate([own, of_parts[kept]])[present]

    return ClusterMotions(
        clusters=from_labels(labels),
        registered=both(motions.registered, part_motions.registered),
        seen_through=both(motions.seen_through, part_motions.seen_through),
        unconfirmed=both(motions.unconfirmed, part_motions.unconfirmed),
        still=both(fit.still_energy_far < STILL_M, part_fit.still_energy_far < STILL_M),
        velocity_m_per_s=both(motions.velocity_m_per_s, part_motions.velocity_m_per_s),
        near_velocity_m_per_s=both(
            motions.near_velocity_m_per_s, part_motions.near_velocity_m_per_s
        ),
        extent_m=both(fit.extent_m, part_fit.extent_m),
    )


def _without_ground_artefacts(
    points_m: Points, found: ClusterMotions, evidence: FreeSpaceEvidence
) -> ClusterMotions:
    """Mark flat clusters on the road as not moving."""
    artefact = are_ground_artefacts(
        points_m,
        found.clusters,
        found.dynamic_now,
        beams_from_odom=evidence.beams_from_odom,
        sensor_height_m=evidence.sensor_height_m,
    )
    return replace(
        found,
        registered=found.registered & ~artefact,
        seen_through=found.seen_through & ~artefact,
        unconfirmed=found.unconfirmed | artefact,
    )
