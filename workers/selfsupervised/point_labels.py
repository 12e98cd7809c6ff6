"""Point labels: one label for every voxel and every point, in a single pass over each."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask
from schemas.labels import MotionLabel
from workers.points.compiled import compiled

UNSURE, ALONE, GROUND, AGREED = 0, 1, 2, 3
"""Sureness of a label, by its evidence: none, one kind, ground removal, two kinds."""

_UNKNOWN: Final = int(MotionLabel.UNKNOWN)
_STATIC: Final = int(MotionLabel.STATIC)
_DYNAMIC: Final = int(MotionLabel.DYNAMIC)


class PointLabels(NamedTuple):
    """Labels of N points.

    Attributes:
        labels: (N,) codes of `MotionLabel`.
        sureness: (N,) UNSURE, ALONE, GROUND or AGREED.
        cluster: (N,) int32, -1 for none.
        confirmed: (N,) the point moves, and more than one frame confirms it.
        ground: (N,) ground that does not belong to a mover.
    """

    labels: NDArray[np.uint8]
    sureness: NDArray[np.uint8]
    cluster: NDArray[np.int32]
    confirmed: Mask
    ground: Mask


@compiled
def label_voxels(
    of_voxel: NDArray[np.int32],
    moves: Mask,
    both: Mask,
    static: Mask,
    doubted: Mask,
    occupied_before: Mask,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Label V voxels by the K clusters they belong to.

    Args:
        of_voxel: (V,) cluster of each, -1 for none.
        moves: (K,) clusters that move.
        both: (K,) clusters whose motion registration and free space both show.
        static: (K,) clusters that fit their earlier place and have no evidence of motion.
        doubted: (K,) clusters with a motion, confirmed or not.
        occupied_before: (V,) voxels that more frames saw occupied than free.

    Returns:
        (V,) labels and (V,) their sureness.
    """
    labels = np.full(len(of_voxel), _UNKNOWN, np.uint8)
    sureness = np.zeros(len(of_voxel), np.uint8)
    for v in range(len(of_voxel)):
        k = of_voxel[v]
        if k >= 0 and moves[k]:
            labels[v] = _DYNAMIC
            sureness[v] = AGREED if both[k] else ALONE
            continue
        still = k >= 0 and static[k]
        seen = occupied_before[v] and not (k >= 0 and doubted[k])
        if still or seen:
            labels[v] = _STATIC
            sureness[v] = AGREED if still and seen else ALONE
    return labels, sureness


@compiled
def label_ground(
    labelled: PointLabels,
    valid_index: NDArray[np.int64],
    ground: Mask,
    in_range: Mask,
    touching: Mask,
    touching_confirmed: Mask,
) -> None:
    """Label the ground: static, or part of the mover that it touches.

    Args:
        labelled: Labels of all N points, filled in.
        valid_index: (M,) indices of the valid points.
        ground: (M,) valid points on the ground.
        in_range: (M,) ground within the range that is labelled.
        touching: (M,) ground that touches a mover.
        touching_confirmed: (M,) ground that touches a confirmed one.
    """
    for i in range(len(valid_index)):
        point = valid_index[i]
        if touching[i]:
            labelled.labels[point] = _DYNAMIC
            labelled.sureness[point] = ALONE
            labelled.confirmed[point] = touching_confirmed[i]
        elif ground[i]:
            labelled.ground[point] = True
            if in_range[i]:
                labelled.labels[point] = _STATIC
                labelled.sureness[point] = GROUND


@compiled
def copy_to_points(
    labelled: PointLabels,
    point_index: NDArray[np.int64],
    of_point: NDArray[np.int32],
    labels: NDArray[np.uint8],
    sureness: NDArray[np.uint8],
    of_voxel: NDArray[np.int32],
    confirmed: Mask,
) -> None:
    """Copy the label of each voxel to its points.

    Args:
        labelled: Labels of all N points, filled in.
        point_index: (J,) indices of the points in voxels.
        of_point: (J,) voxel of each of them.
        labels: (V,) of the voxels.
        sureness: (V,) of those labels.
        of_voxel: (V,) cluster of each voxel.
        confirmed: (K,) clusters that are confirmed.
    """
    for i in range(len(point_index)):
        point, voxel = point_index[i], of_point[i]
        k = of_voxel[voxel]
        labelled.labels[point] = labels[voxel]
        labelled.sureness[point] = sureness[voxel]
        labelled.cluster[point] = k
        labelled.confirmed[point] = k >= 0 and confirmed[k]


def label_near_points(
    labelled: PointLabels,
    point_index: NDArray[np.int64],
    of_mover: NDArray[np.int32],
    confirmed: Mask,
) -> None:
    """Label points nearer than points are judged as part of the movers that they continue.

    Args:
        labelled: Labels of all N points, filled in.
        point_index: (P,) indices of these points.
        of_mover: (P,) cluster of each.
        confirmed: (K,) clusters that are confirmed.
    """
    labelled.labels[point_index] = _DYNAMIC
    labelled.sureness[point_index] = ALONE
    labelled.cluster[point_index] = of_mover
    labelled.confirmed[point_index] = confirmed[of_mover]


def unlabelled_points(n: int) -> PointLabels:
    """Return UNKNOWN labels for N points."""
    return PointLabels(
        labels=np.full(n, _UNKNOWN, np.uint8),
        sureness=np.zeros(n, np.uint8),
        cluster=np.full(n, -1, np.int32),
        confirmed=np.zeros(n, np.bool_),
        ground=np.zeros(n, np.bool_),
    )
