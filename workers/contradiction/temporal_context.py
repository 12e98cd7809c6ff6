"""Temporal context: labels of an object by both streams before and after they contradict."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.contradiction import CONTEXT_S, Instance, LabelledFrame, Scene
from workers.contradiction.box_queries import counts_in_boxes, rows_labelled

MARGIN_M: Final = 0.5
"""Margin around a box, metres: boxes of partly observed objects are too short."""

COMPLETE_SHARE: Final = 0.5
"""Minimum point ratio of a complete observation: of an instance to its track's median, and of the
points labelled at another time to the nearest instance."""

BEST_S: Final = 0.3
"""Time over which a label is no flicker, seconds: three frames at 10 Hz."""

_WIDE_M: Final = 2e6
"""Extent of a frame on the sort axis, metres: no scene is wider, and frames follow each other."""

_MOST_M: Final = _WIDE_M / 2 - 1.0
"""Bound of a coordinate either way, metres: points of a lost pose stay in their own frame."""


@dataclass(frozen=True, slots=True, eq=False)
class DynamicPoints:
    """Points that the supervised stream labels dynamic, in a scene and its context.

    Attributes:
        stamps_ns: (T,) stamps of the frames of `frames_with_context`.
        order: (M,) ascending sort key: 2,000 km times the frame number, plus x from the first pose.
        places_m: (M, 3) the points, odom space.
        agreed: (M,) mask of points that the self-supervised stream labels dynamic too.
        not_refuted: (M,) mask of points not refuted by it: labelled dynamic too, or left unlabelled
            in a frame in which it is not blind.
    """

    stamps_ns: NDArray[np.int64]
    order: NDArray[np.float64]
    places_m: NDArray[np.float64]
    agreed: NDArray[np.bool_]
    not_refuted: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class TemporalContext:
    """Shares of an object, 0 to 1, over the frames in which they are highest, a third of a second.

    The halves of its track, by points, and a second beyond each end are `before` and `after`.

    Attributes:
        agreed_before: Share that both streams label dynamic earlier.
        not_refuted_after: Share that the supervised stream labels dynamic later, and the other
            stream does not label static.
        dynamic_before: Share that the supervised stream labels dynamic earlier, whatever the other
            stream labels.
        dynamic_after: Share that the supervised stream labels dynamic later.
        frames_alone: Frames of the track, and others up to a second away in which the supervised
            stream alone labels at least half of it dynamic.
    """

    agreed_before: float
    not_refuted_after: float
    dynamic_before: float
    dynamic_after: float
    frames_alone: int


def frames_with_context(scene: Scene) -> tuple[LabelledFrame, ...]:
    """Return the frames of a scene with those of its context before and after it, in order."""
    return (*scene.before, *scene.frames, *scene.after)


def dynamic_points_of(scene: Scene) -> DynamicPoints:
    """Collect the points off the ground that the supervised stream labels dynamic.

    Points without a finite place are left out; a task other than motion has none.
    """
    origin_m = scene.frames[0].posed.odom_from_sensor[0, 3]
    places, order = [np.zeros((0, 3))], [np.zeros(0)]
    agreed, not_refuted = [np.zeros(0, np.bool_)], [np.zeros(0, np.bool_)]
    frames = frames_with_context(scene)
    for number, frame in enumerate(frames):
        labels, other = frame.semantic.labels, frame.predictive
        points_m, ground = frame.posed.frame.points_m, other.ground_mask
        if ground is None:
            ground = np.zeros(len(labels), np.bool_)
        rows = np.zeros(0, np.int64)
        if scene.task.moving:
            moving = scene.task.classes.index(scene.task.moving)
            rows = rows_labelled(points_m, labels, moving, ground)
        pose, other_labels = frame.posed.odom_from_sensor, other.labels[rows]
        placed_m = points_m[rows].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        both = other_labels == labels[rows]
        left_open = (other_labels == scene.task.unknown) & (other.health.blindness is None)
        along = _along(number, placed_m[:, 0] - origin_m)
        by_place = np.argsort(along, kind="stable")
        places.append(placed_m[by_place])
        order.append(along[by_place])
        agreed.append(both[by_place])
        not_refuted.append((both | left_open)[by_place])
    return DynamicPoints(
        stamps_ns=np.array([frame.stamp_ns for frame in frames], np.int64),
        order=np.concatenate(order),
        places_m=np.concatenate(places),
        agreed=np.concatenate(agreed),
        not_refuted=np.concatenate(not_refuted),
    )


def temporal_context_of(
    scene: Scene,
    members: Sequence[Instance],
    centres_m: NDArray[np.float64],
    velocity_m_per_s: NDArray[np.float64],
    dynamic_points: DynamicPoints,
    *,
    period_s: float,
) -> TemporalContext:
    """Measure the labels of an object at its predicted places in all frames around its track.

    When an object starts, the self-supervised stream labels it static, then unknown, then dynamic.
    Later it therefore need not agree: it suffices that it does not refute. Earlier that does not
    suffice, since a new object has no label whatever its motion. Fragments in a track do not
    determine the place of the object.

    Args:
        scene: Scene of the track.
        members: Its instances, in the order of their frames.
        centres_m: (len(members), 3) centres of their boxes, odom space.
        velocity_m_per_s: (2,) or (3,) velocity of the track, odom space.
        dynamic_points: Points of `dynamic_points_of`.
        period_s: Median time between frames; 0 for a single frame.
    """
    points = np.array([len(member.point_index) for member in members])
    large = points >= COMPLETE_SHARE * np.median(points)
    edges = [member for member, whole in zip(members, large, strict=True) if whole]
    edge_ns = np.array([scene.frames[edge.frame_index].stamp_ns for edge in edges], np.int64)
    away_ns = dynamic_points.stamps_ns[:, None] - edge_ns
    nearest = np.abs(away_ns).argmin(axis=1)
    away_s = away_ns[np.arange(len(away_ns)), nearest] / NS_PER_S
    within = np.flatnonzero(np.abs(away_s) <= CONTEXT_S)
    counts = _counts(
        *(scene, edges, centres_m[large], nearest[within]),
        *(within, away_s[within], velocity_m_per_s, dynamic_points),
    )
    whole_thing = COMPLETE_SHARE * points[large][nearest[within]]
    halfway = int(np.searchsorted(np.cumsum(points), points.sum() / 2))
    before = dynamic_points.stamps_ns[within] < scene.frames[members[halfway].frame_index].stamp_ns
    best = max(1, round(BEST_S / period_s)) if period_s > 0 else 1

    def share(counts: NDArray[np.int64], when: NDArray[np.bool_]) -> float:
        shares = np.minimum(1.0, counts / whole_thing)[when]
        return float(np.sort(shares)[-best:].sum()) / best

    agreed, not_refuted, every = counts
    alone = set(within[every - agreed >= whole_thing].tolist())
    own_ns = [scene.frames[member.frame_index].stamp_ns for member in members]
    alone |= set(np.searchsorted(dynamic_points.stamps_ns, own_ns).tolist())
    return TemporalContext(
        agreed_before=share(agreed, before),
        not_refuted_after=share(not_refuted, ~before),
        dynamic_before=share(every, before),
        dynamic_after=share(every, ~before),
        frames_alone=len(alone),
    )


def _counts(
    scene: Scene,
    edges: Sequence[Instance],
    centres_m: NDArray[np.float64],
    edge: NDArray[np.int64],
    moment: NDArray[np.int64],
    away_s: NDArray[np.float64],
    velocity_m_per_s: NDArray[np.float64],
    dynamic_points: DynamicPoints,
) -> NDArray[np.int64]:
    """Count the points labelled dynamic in predicted boxes and their margins.

    Args:
        scene: Scene of the boxes.
        edges: Instances with the boxes.
        centres_m: (len(edges), 3) centres of the boxes, odom space.
        edge: (R,) index of the box in each query.
        moment: (R,) index of the frame in each query.
        away_s: (R,) time from the box to the frame, seconds.
        velocity_m_per_s: (2,) or (3,) velocity of the boxes, odom space.
        dynamic_points: The points.

    Returns:
        (3, R) agreed points, points not refuted, and all points.
    """
    poses = np.stack([scene.frames[each.frame_index].posed.odom_from_sensor for each in edges])
    half_m = np.stack([each.size_m for each in edges]) / 2.0 + MARGIN_M
    moved_m = np.zeros((len(edge), 3))
    moved_m[:, :2] = velocity_m_per_s[:2] * away_s[:, None]
    middle_m = centres_m[edge] + moved_m
    reach_m = np.linalg.norm(half_m, axis=1)[edge]
    x_m = middle_m[:, 0] - scene.frames[0].posed.odom_from_sensor[0, 3]
    first = np.searchsorted(dynamic_points.order, _along(moment, x_m - reach_m), side="left")
    last = np.searchsorted(dynamic_points.order, _along(moment, x_m + reach_m), side="right")
    yaw_rad = np.array([each.yaw_rad for each in edges])
    turned = poses[:, :3, :3] @ _about_z(yaw_rad)
    return counts_in_boxes(
        *(dynamic_points.places_m, dynamic_points.agreed, dynamic_points.not_refuted, first, last),
        *(middle_m, turned[edge], half_m[edge]),
    )


def _about_z(yaw_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rotations (N, 3, 3) about z, with the axes of a box as columns."""
    turns = np.zeros((len(yaw_rad), 3, 3))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(yaw_rad)
    turns[:, 1, 0] = np.sin(yaw_rad)
    turns[:, 0, 1] = -turns[:, 1, 0]
    turns[:, 2, 2] = 1.0
    return turns


def _along(moment: NDArray[np.int64] | int, x_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sort keys of points, from their frame and x."""
    clipped_m: NDArray[np.float64] = np.clip(x_m, -_MOST_M, _MOST_M)
    return clipped_m + np.asarray(moment, np.float64) * _WIDE_M
