"""What both streams say of a thing at other times than when they contradict each other about it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.contradiction import BESIDE_S, Instance, LabelledFrame, Scene
from workers.contradiction.box_queries import counts_in_boxes, rows_said

MARGIN_M: Final = 0.5
"""Boxes of half-seen things end short."""

MOST: Final = 0.5
"""So many points as this share of the track's own are the whole thing; and so much of its usual
points a scrap of it has not."""

BEST_S: Final = 0.3
"""A label that holds for as long is no flicker: three frames at 10 Hz."""

_WIDE_M: Final = 2e6
"""No scene is wider: frames lie side by side along one axis."""

_MOST_M: Final = _WIDE_M / 2 - 1.0
"""Either way: a pose that is lost leaves no moment for another."""


@dataclass(frozen=True, slots=True, eq=False)
class CalledMoving:
    """Points that the supervised stream calls moving, in a scene and right before and after it.

    Attributes:
        stamps_ns: (T,) of `moments`.
        order: (M,) rising: 2,000 km times the moment, and x from the first pose on.
        places_m: (M, 3) where they are, odom space.
        agreed: (M,) whether the self-supervised stream calls them moving as well.
        undenied: (M,) whether it does, or leaves them open while it judges others.
    """

    stamps_ns: NDArray[np.int64]
    order: NDArray[np.float64]
    places_m: NDArray[np.float64]
    agreed: NDArray[np.bool_]
    undenied: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class OtherTimes:
    """Shares of a thing, 0 to 1, in the third of a second in which they are highest.

    Before and after are the halves of its track, by its points, and a second beyond its ends.

    Attributes:
        agreed_before: That both streams call moving.
        undenied_after: That the supervised stream calls moving, and the other one does not deny.
        called_before: That the supervised stream calls moving, whatever the other one says.
        called_after: The same, later.
    """

    agreed_before: float
    undenied_after: float
    called_before: float
    called_after: float


def moments(scene: Scene) -> tuple[LabelledFrame, ...]:
    """List the frames of a scene, and those that lie right before and after it."""
    return (*scene.before, *scene.frames, *scene.after)


def called_moving(scene: Scene) -> CalledMoving:
    """List the points that the supervised stream calls moving, off the ground and somewhere.

    None where the task asks for no motion.
    """
    origin_m = scene.frames[0].posed.odom_from_sensor[0, 3]
    places, order = [np.zeros((0, 3))], [np.zeros(0)]
    agreed, undenied = [np.zeros(0, np.bool_)], [np.zeros(0, np.bool_)]
    frames = moments(scene)
    for number, frame in enumerate(frames):
        said, other = frame.semantic.labels, frame.predictive
        points_m, ground = frame.posed.frame.points_m, other.ground_mask
        if ground is None:
            ground = np.zeros(len(said), np.bool_)
        claimed = np.zeros(0, np.int64)
        if scene.task.moving:
            moving = scene.task.classes.index(scene.task.moving)
            claimed = rows_said(points_m, said, moving, ground)
        pose, answers = frame.posed.odom_from_sensor, other.labels[claimed]
        mine_m = points_m[claimed].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        both = answers == said[claimed]
        left_open = (answers == scene.task.unknown) & (other.health.blindness is None)
        along = _along(number, mine_m[:, 0] - origin_m)
        by_place = np.argsort(along, kind="stable")
        places.append(mine_m[by_place])
        order.append(along[by_place])
        agreed.append(both[by_place])
        undenied.append((both | left_open)[by_place])
    return CalledMoving(
        stamps_ns=np.array([frame.stamp_ns for frame in frames], np.int64),
        order=np.concatenate(order),
        places_m=np.concatenate(places),
        agreed=np.concatenate(agreed),
        undenied=np.concatenate(undenied),
    )


def at_other_times(
    scene: Scene,
    members: Sequence[Instance],
    centres_m: NDArray[np.float64],
    velocity_m_per_s: NDArray[np.float64],
    called: CalledMoving,
    *,
    period_s: float,
) -> OtherTimes:
    """Say what both streams say of a thing where it should be in all frames around its track.

    Of what starts the self-supervised stream says "stands", nothing, "moves": later it need not
    agree, not to deny is enough. Earlier it is not: what is new is left open whatever it does.
    Scraps that are tied to a track do not say where the thing is.

    Args:
        scene: Where the track was found.
        members: Its instances, in the order of their frames.
        centres_m: (len(members), 3) of their boxes, odom space.
        velocity_m_per_s: (2,) or (3,) how it goes, odom space.
        called: As `called_moving` lists it.
        period_s: Between frames; 0 where there is but one.
    """
    points = np.array([len(member.point_index) for member in members])
    large = points >= MOST * np.median(points)
    edges = [member for member, whole in zip(members, large, strict=True) if whole]
    edge_ns = np.array([scene.frames[edge.frame_index].stamp_ns for edge in edges], np.int64)
    away_ns = called.stamps_ns[:, None] - edge_ns
    nearest = np.abs(away_ns).argmin(axis=1)
    away_s = away_ns[np.arange(len(away_ns)), nearest] / NS_PER_S
    within = np.flatnonzero(np.abs(away_s) <= BESIDE_S)
    counts = _counts(
        *(scene, edges, centres_m[large], nearest[within]),
        *(within, away_s[within], velocity_m_per_s, called),
    )
    whole_thing = MOST * points[large][nearest[within]]
    halfway = int(np.searchsorted(np.cumsum(points), points.sum() / 2))
    before = called.stamps_ns[within] < scene.frames[members[halfway].frame_index].stamp_ns
    best = max(1, round(BEST_S / period_s)) if period_s > 0 else 1

    def share(counts: NDArray[np.int64], when: NDArray[np.bool_]) -> float:
        shares = np.minimum(1.0, counts / whole_thing)[when]
        return float(np.sort(shares)[-best:].sum()) / best

    agreed, undenied, every = counts
    return OtherTimes(
        agreed_before=share(agreed, before),
        undenied_after=share(undenied, ~before),
        called_before=share(every, before),
        called_after=share(every, ~before),
    )


def _counts(
    scene: Scene,
    edges: Sequence[Instance],
    centres_m: NDArray[np.float64],
    edge: NDArray[np.int64],
    moment: NDArray[np.int64],
    away_s: NDArray[np.float64],
    velocity_m_per_s: NDArray[np.float64],
    called: CalledMoving,
) -> NDArray[np.int64]:
    """Count the points that are called moving in a box, and its margin, at some moments.

    Args:
        scene: Where the boxes were found.
        edges: Whose boxes.
        centres_m: (len(edges), 3) their centres, odom space.
        edge: (R,) which of them.
        moment: (R,) when.
        away_s: (R,) how much later than the box.
        velocity_m_per_s: How the boxes go.
        called: The points.

    Returns:
        (3, R) those agreed, undenied, and all of them.
    """
    poses = np.stack([scene.frames[each.frame_index].posed.odom_from_sensor for each in edges])
    half_m = np.stack([each.size_m for each in edges]) / 2.0 + MARGIN_M
    moved_m = np.zeros((len(edge), 3))
    moved_m[:, :2] = velocity_m_per_s[:2] * away_s[:, None]
    middle_m = centres_m[edge] + moved_m
    reach_m = np.linalg.norm(half_m, axis=1)[edge]
    x_m = middle_m[:, 0] - scene.frames[0].posed.odom_from_sensor[0, 3]
    first = np.searchsorted(called.order, _along(moment, x_m - reach_m), side="left")
    last = np.searchsorted(called.order, _along(moment, x_m + reach_m), side="right")
    yaw_rad = np.array([each.yaw_rad for each in edges])
    turned = poses[:, :3, :3] @ _about_z(yaw_rad)
    return counts_in_boxes(
        *(called.places_m, called.agreed, called.undenied, first, last),
        *(middle_m, turned[edge], half_m[edge]),
    )


def _about_z(yaw_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 3, 3) turns, the axes of a box as columns."""
    turns = np.zeros((len(yaw_rad), 3, 3))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(yaw_rad)
    turns[:, 1, 0] = np.sin(yaw_rad)
    turns[:, 0, 1] = -turns[:, 1, 0]
    turns[:, 2, 2] = 1.0
    return turns


def _along(moment: NDArray[np.int64] | int, x_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where points of several moments lie on one axis."""
    clipped_m: NDArray[np.float64] = np.clip(x_m, -_MOST_M, _MOST_M)
    return clipped_m + np.asarray(moment, np.float64) * _WIDE_M
