"""Instance clustering: contradicting points of one kind in one frame, with their boxes."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Labels, Mask
from schemas.contradiction import Instance, LabelledFrame, Scene
from schemas.labels import MotionLabel
from schemas.task import Outcome
from workers.contradiction.boxes import fit_box
from workers.contradiction.neighbour_counts import counts_around
from workers.contradiction.neighbourhood import LabelledPoints
from workers.contradiction.settings import DEFAULT_INSTANCES, InstanceSettings
from workers.points.density import density_clusters, weighted_places
from workers.points.point_kernels import within_box


def find_instances(
    scene: Scene,
    *,
    class_names: Sequence[str],
    settings: InstanceSettings = DEFAULT_INSTANCES,
) -> tuple[Instance, ...]:
    """Cluster the contradicting points of every frame, each kind on its own.

    DBSCAN (scikit-learn) as in the paper, on places instead of points (see `InstanceSettings`).
    Ground is left out: a network's dynamic labels bleed onto the road next to a mover, and these
    points are no object of their own. The raw shares still count them.

    Args:
        scene: Labelled frames of one scene.
        class_names: Names that the supervised stream's class ids index.
        settings: Constants of the clustering.

    Returns:
        Instances by frame, kind (in the order of the task) and lowest point index.
    """
    return tuple(
        instance
        for frame_index, frame in enumerate(scene.frames)
        for instance in _instances_in(
            frame, frame_index=frame_index, class_names=class_names, settings=settings
        )
    )


def cluster_places(
    points_m: NDArray[np.float32], *, settings: InstanceSettings
) -> NDArray[np.int64]:
    """Cluster points by DBSCAN over weighted voxels.

    Args:
        points_m: (N, 3) points, metres.
        settings: Neighbourhood, core size, voxels.

    Returns:
        (N,) cluster of each point, -1 for noise.
    """
    if len(points_m) < settings.min_points:
        return np.full(len(points_m), -1, dtype=np.int64)
    if settings.voxel_m == 0:
        from sklearn.cluster import DBSCAN  # a second to import: only whoever asks for points waits

        found = DBSCAN(eps=settings.eps_m, min_samples=settings.min_points)
        return np.asarray(found.fit_predict(points_m), dtype=np.int64)
    voxel_m = settings.voxel_m
    while True:
        places_m, place, weight = weighted_places(points_m, np.float32(voxel_m))
        if len(places_m) <= settings.max_voxels or voxel_m >= settings.coarsest_voxel_m:
            break
        voxel_m *= 2
    clusters = density_clusters(places_m, weight, settings.eps_m, settings.min_points)
    of_point: NDArray[np.int64] = clusters[place]
    return of_point


def _instances_in(
    frame: LabelledFrame,
    *,
    frame_index: int,
    class_names: Sequence[str],
    settings: InstanceSettings,
) -> Iterator[Instance]:
    """Yield the instances of one frame, by kind."""
    points_m, ground_mask = frame.posed.frame.points_m, frame.predictive.ground_mask
    apart = within_box(points_m, settings.max_coordinate_m)
    if ground_mask is not None:
        apart &= ~ground_mask
    for kind in frame.task.kinds:
        yield from _instances_of(
            frame,
            kind,
            apart,
            frame_index=frame_index,
            class_names=class_names,
            settings=settings,
        )


def _instances_of(
    frame: LabelledFrame,
    kind: Outcome,
    apart: Mask,
    *,
    frame_index: int,
    class_names: Sequence[str],
    settings: InstanceSettings,
) -> Iterator[Instance]:
    """Yield the instances of one kind among the points (N,) off the ground and within bounds."""
    points_m = frame.posed.frame.points_m
    queried, contradicting = _candidates(frame, kind)
    queried &= apart
    candidates = np.flatnonzero(queried & contradicting)
    clusters = cluster_places(points_m[candidates], settings=settings)
    found = int(clusters.max(initial=-1)) + 1
    if not found:
        return
    own, around = counts_around(points_m, candidates, queried, np.float32(settings.around_m))
    labelled_points = _labelled_points(frame, kind)
    _, agreed = counts_around(
        points_m, candidates, _agreed(frame, kind) & apart, np.float32(settings.rim_m)
    )
    order = np.argsort(clusters, kind="stable")
    first = np.searchsorted(clusters[order], np.arange(found + 1))
    members = [order[first[c] : first[c + 1]] for c in range(found)]
    for member in sorted(members, key=lambda m: int(m[0])):
        index = candidates[member]
        if len(index) < settings.min_points and settings.voxel_m > 0:
            continue  # a border place may have gone to a neighbour: what is left is too small
        centre_m, size_m, yaw_rad = fit_box(points_m[index])
        denied_share, agreed_share = labelled_points.label_shares(points_m[index])
        yield Instance(
            kind=kind,
            frame_index=frame_index,
            point_index=index,
            centre_m=centre_m,
            size_m=size_m,
            yaw_rad=yaw_rad,
            semantic_confidence=float(frame.semantic.confidence[index].mean(dtype=np.float64)),
            predictive_confidence=float(frame.predictive.confidence[index].mean(dtype=np.float64)),
            class_name=_class_name(frame, index, class_names),
            velocity_m_per_s=_velocity(frame, index),
            own_share=float(own[member].sum() / around[member].sum()),
            confirmed_share=_confirmed_share(frame, kind, index),
            denied_share=denied_share,
            agreed_share=agreed_share,
            rim_share=float((agreed[member] > 0).mean()),
        )


def _candidates(frame: LabelledFrame, kind: Outcome) -> tuple[Mask, Mask]:
    """Return masks (N,) of the points that can contradict in this way, and of those that do."""
    if not kind.of_witness:
        return frame.agreements != frame.task.not_compared, frame.agreements == kind.code
    if frame.witness is None:
        nowhere = np.zeros(len(frame.agreements), np.bool_)
        return nowhere, nowhere
    witness, moving = frame.witness.labels, frame.task.classes.index(frame.task.moving)
    comparable = (frame.semantic.labels < frame.task.unknown) & (witness != MotionLabel.UNKNOWN)
    # the self-supervised stream may also be silent
    static = (frame.semantic.labels != moving) & (frame.predictive.labels != moving)
    return comparable, comparable & static & (witness == MotionLabel.DYNAMIC)


def _agreed(frame: LabelledFrame, kind: Outcome) -> Mask:
    """Return the points (N,) that the source of a kind and the other stream both label dynamic."""
    chosen, other = _source_and_other(frame, kind)
    agreed: Mask = chosen & (other == MotionLabel.DYNAMIC)
    return agreed


def _labelled_points(frame: LabelledFrame, kind: Outcome) -> LabelledPoints:
    """Return all points with the contradicting source's label, and the other stream's labels."""
    chosen, other = _source_and_other(frame, kind)
    if frame.predictive.ground_mask is not None:
        chosen = chosen & ~frame.predictive.ground_mask
    rows = np.flatnonzero(chosen)
    return LabelledPoints(frame.posed.frame.points_m[rows], other[rows])


def _source_and_other(frame: LabelledFrame, kind: Outcome) -> tuple[Mask, Labels]:
    """Return the points that the source of a kind labels, and the labels of the other stream."""
    if kind.of_witness and frame.witness is not None:
        chosen, other = frame.witness.labels == MotionLabel.DYNAMIC, frame.predictive.labels
    elif kind.measured:
        chosen = frame.predictive.labels == frame.task.classes.index(kind.predictive)
        other = frame.semantic.labels
    else:
        chosen = frame.semantic.labels == frame.task.classes.index(kind.semantic)
        other = frame.predictive.labels
    return chosen, other


def _class_name(frame: LabelledFrame, index: NDArray[np.int64], class_names: Sequence[str]) -> str:
    if frame.semantic.class_id is None or not class_names:
        return ""
    classes = frame.semantic.class_id[index]
    classes = classes[(classes >= 0) & (classes < len(class_names))]
    return class_names[int(np.bincount(classes).argmax())] if len(classes) else ""


def _confirmed_share(frame: LabelledFrame, kind: Outcome, index: NDArray[np.int64]) -> float | None:
    confirmed = frame.predictive.confirmed
    if confirmed is None or not kind.measured:
        return None
    return float(confirmed[index].mean(dtype=np.float64))


def _velocity(frame: LabelledFrame, index: NDArray[np.int64]) -> NDArray[np.float64]:
    cluster = frame.predictive.cluster
    velocities = frame.predictive.cluster_velocity_m_per_s
    if cluster is None or velocities is None:
        return np.zeros(3)
    clusters = cluster[index]
    each = velocities[clusters[clusters >= 0]]
    each = each[np.isfinite(each).all(axis=1)]
    return each.mean(axis=0, dtype=np.float64) if len(each) else np.zeros(3)
