"""What both streams say of a track's place just before it begins and just after it ends."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.contradiction import BESIDE_S, Instance, LabelledFrame, Scene

MARGIN_M: Final = 0.5
"""Boxes of half-seen things end short."""

MOST: Final = 0.5
"""So many points as this share of the track's own are the whole thing."""


@dataclass(frozen=True, slots=True, eq=False)
class Claimed:
    """Points that the supervised stream calls moving, odom space.

    Attributes:
        agreed_m: (M, 3) that the self-supervised stream calls moving as well.
        undenied_m: (M, 3) the same, and those that it leaves open while it judges others.
    """

    agreed_m: NDArray[np.float64]
    undenied_m: NDArray[np.float64]


def moments(scene: Scene) -> tuple[LabelledFrame, ...]:
    """List the frames of a scene, and those that lie right before and after it."""
    return (*scene.before, *scene.frames, *scene.after)


def called_moving(scene: Scene) -> tuple[Claimed, ...]:
    """List the points that the supervised stream calls moving, off the ground and somewhere.

    Returns:
        One for each of `moments`, empty where the task asks for no motion.
    """
    told: list[Claimed] = []
    for frame in moments(scene):
        said, other = frame.semantic.labels, frame.predictive
        claimed = np.zeros(len(said), np.bool_)
        if scene.task.moving:
            claimed = said == scene.task.classes.index(scene.task.moving)
        if other.ground_mask is not None:
            claimed = claimed & ~other.ground_mask
        points_m = frame.posed.frame.points_m
        claimed[claimed] = np.isfinite(points_m[claimed]).all(axis=1)
        pose, answers = frame.posed.odom_from_sensor, other.labels[claimed]
        blind = other.health.blindness is not None
        places_m = points_m[claimed].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        agreed = answers == said[claimed]
        undenied = agreed | ((answers == scene.task.unknown) & (not blind))
        told.append(Claimed(places_m[agreed], places_m[undenied]))
    return tuple(told)


def agreed_beside(
    scene: Scene,
    members: Sequence[Instance],
    velocity_m_per_s: NDArray[np.float64],
    claimed: Sequence[Claimed],
) -> tuple[float, float]:
    """Say how much of a thing both streams call moving right before and right after its track.

    After it, what the self-supervised stream leaves open counts as well: it called standing what it
    no longer does, as of a thing that starts, whose place is neither free nor taken yet. Before it,
    what is new is left open whatever it does.

    Args:
        scene: Where the track was found.
        members: Its instances, in the order of their frames.
        velocity_m_per_s: (2,) or (3,) how it goes, odom space.
        claimed: As `called_moving` lists them.

    Returns:
        Shares from 0 to 1, means over the frames within reach; 0 where there is none.
    """
    first, last, before = members[0], members[-1], len(scene.before)
    stamps_ns = [frame.stamp_ns for frame in moments(scene)]
    backwards = range(before + first.frame_index - 1, -1, -1)
    onwards = range(before + last.frame_index + 1, len(claimed))
    agreed_m = [each.agreed_m for each in claimed]
    undenied_m = [each.undenied_m for each in claimed]
    return (
        _agreed(scene, first, velocity_m_per_s, agreed_m, stamps_ns, backwards),
        _agreed(scene, last, velocity_m_per_s, undenied_m, stamps_ns, onwards),
    )


def _agreed(
    scene: Scene,
    edge: Instance,
    velocity_m_per_s: NDArray[np.float64],
    moving_m: Sequence[NDArray[np.float64]],
    stamps_ns: Sequence[int],
    frames: Sequence[int],
) -> float:
    at = scene.frames[edge.frame_index]
    pose = at.posed.odom_from_sensor
    shares = []
    for number in frames:
        away_s = (stamps_ns[number] - at.stamp_ns) / NS_PER_S
        if abs(away_s) > BESIDE_S:
            break
        moved_m = np.zeros(3)
        moved_m[:2] = velocity_m_per_s[:2] * away_s
        inside = _inside(edge, (moving_m[number] - moved_m - pose[:3, 3]) @ pose[:3, :3])
        shares.append(min(1.0, inside / (MOST * len(edge.point_index))))
    return float(np.mean(shares)) if shares else 0.0


def _inside(instance: Instance, points_m: NDArray[np.float64]) -> int:
    """How many points lie in the box of an instance, and its margin; sensor space."""
    away_m = points_m - instance.centre_m
    cos, sin = np.cos(instance.yaw_rad), np.sin(instance.yaw_rad)
    half_m = instance.size_m / 2.0 + MARGIN_M
    inside = np.abs(away_m[:, 0] * cos + away_m[:, 1] * sin) <= half_m[0]
    inside &= np.abs(away_m[:, 1] * cos - away_m[:, 0] * sin) <= half_m[1]
    inside &= np.abs(away_m[:, 2]) <= half_m[2]
    return int(inside.sum())
