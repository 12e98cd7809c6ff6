"""Objects of interest: the objects of a scene on which the supervised stream is evaluated.

A *failure* is an object with at least 25 wrong points that are most of its points, in frames that
together last half a second. Objects come from the truth. Wrong points without an object are
clustered into objects of their own: a phantom on a wall, a mover without a box.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from schemas.arrays import Mask
from schemas.contradiction import ContradictionKind, Instance, Scene
from schemas.task import MOTION
from workers.contradiction.boxes import fit_box
from workers.contradiction.instances import cluster_places
from workers.contradiction.settings import DEFAULT_INSTANCES
from workers.contradiction.tracks import associate_instances, frame_period_s
from workers.lab.evaluation.failures.frame_truth import FrameWithTruth

MIN_POINTS: Final = 25
MIN_S: Final = 0.5
_RIM_M: Final = 0.5
_RIM_RAD: Final = float(np.radians(1.0))
_TOLERANCE: Final = 1e-6

Points = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class ObjectOfInterest:
    """One object of interest of a scene.

    Attributes:
        key: Its name in the scene: `track 7`, `phantom 0`, `missed 1`.
        track: True track number; -1 none.
        class_name: True class; empty where truth has none.
        moves: Whether it truly moves, in most frames.
        points: By frame of the scene, its points whose true motion is known; frames with 25 or
            more.
        failing: Frames in which the supervised stream is wrong on most of its points.
        fails: Whether these frames last long enough.
    """

    key: str
    track: int
    class_name: str
    moves: bool
    points: dict[int, Points]
    failing: tuple[int, ...]
    fails: bool


def frames_in(seconds: float, period_s: float) -> int:
    """Return the number of frames that last this long, at least one."""
    return max(1, ceil(seconds / period_s - _TOLERANCE)) if period_s > 0 else 1


def find_objects(scene: Scene, seen: Sequence[FrameWithTruth]) -> list[ObjectOfInterest]:
    """Find the objects of interest of a scene.

    Args:
        scene: The labelled frames.
        seen: The same frames with their truth.
    """
    enough = frames_in(MIN_S, frame_period_s(scene))
    return [*_objects(seen, enough), *_unowned(scene, seen, enough)]


def _objects(seen: Sequence[FrameWithTruth], enough: int) -> Iterator[ObjectOfInterest]:
    points: dict[int, dict[int, Points]] = {}
    for number, frame in enumerate(seen):
        track = np.where(frame.known, frame.track, -1)
        order = np.argsort(track, kind="stable")
        ids, first = np.unique(track[order], return_index=True)
        for each, mine in zip(ids.tolist(), np.split(order, first[1:]), strict=True):
            if each >= 0 and len(mine) >= MIN_POINTS:
                points.setdefault(each, {})[number] = mine
    wrong = [frame.wrong(frame.labelled.semantic) for frame in seen]
    for track_id, by_frame in sorted(points.items()):
        if len(by_frame) < enough:
            continue
        failing = [number for number, mine in by_frame.items() if _errs(wrong[number][mine])]
        moving = [bool(seen[number].moving[mine].mean() > 0.5) for number, mine in by_frame.items()]
        yield ObjectOfInterest(
            key=f"track {track_id}",
            track=track_id,
            class_name=seen[next(iter(by_frame))].class_of(track_id),
            moves=sum(moving) * 2 > len(moving),
            points=by_frame,
            failing=tuple(failing),
            fails=len(failing) >= enough,
        )


def _errs(wrong: Mask) -> bool:
    return bool(wrong.sum() >= MIN_POINTS and 2 * wrong.sum() > len(wrong))


def _unowned(
    scene: Scene, seen: Sequence[FrameWithTruth], enough: int
) -> Iterator[ObjectOfInterest]:
    """Cluster and track wrong points without an object; yield the tracks that last long enough."""
    for moves, name in ((False, "phantom"), (True, "missed")):
        instances: list[Instance] = []
        for number, frame in enumerate(seen):
            wrong = frame.wrong(frame.labelled.semantic) & (frame.track < 0)
            wrong &= frame.moving == moves
            ground = frame.labelled.predictive.ground_mask
            wrong &= True if ground is None else ~ground
            instances += _instances(frame, number, np.flatnonzero(wrong))
        number = 0
        for track in associate_instances(scene, instances):
            members = [instances[member] for member in track.members]
            if len(members) < enough:
                continue
            by_frame = {each.frame_index: each.point_index for each in members}
            frames = tuple(by_frame)
            yield ObjectOfInterest(f"{name} {number}", -1, "", moves, by_frame, frames, fails=True)
            number += 1


def _instances(frame: FrameWithTruth, number: int, candidates: Points) -> Iterator[Instance]:
    cloud = frame.labelled.posed.frame.points_m
    clusters = cluster_places(cloud[candidates], settings=DEFAULT_INSTANCES)
    movers = np.flatnonzero(frame.moving & (frame.track >= 0))
    for cluster in range(int(clusters.max(initial=-1)) + 1):
        mine = candidates[clusters == cluster]
        if len(mine) < MIN_POINTS or _is_rim(cloud[mine], cloud[movers]):
            continue
        centre_m, size_m, yaw_rad = fit_box(cloud[mine])
        yield Instance(
            kind=MOTION.kind(ContradictionKind.ONLY_SEMANTIC_DYNAMIC),
            frame_index=number,
            point_index=mine,
            centre_m=centre_m,
            size_m=size_m,
            yaw_rad=yaw_rad,
            semantic_confidence=1.0,
            predictive_confidence=1.0,
        )


def _is_rim(points_m: NDArray[np.float32], movers_m: NDArray[np.float32]) -> bool:
    """Test whether most points lie at the border of a true mover: bled labels are no object.

    The border is within 0.5 m, or behind the mover and within a degree of its outline.
    """
    if not len(movers_m):
        return False
    near, _ = cKDTree(movers_m).query(points_m, distance_upper_bound=_RIM_M)
    range_m, movers_range_m = (np.linalg.norm(each, axis=1) for each in (points_m, movers_m))
    ways, of_movers = points_m / range_m[:, None], movers_m / movers_range_m[:, None]
    away, which = cKDTree(of_movers).query(ways, distance_upper_bound=_RIM_RAD)
    behind = np.isfinite(away)
    behind[behind] = range_m[behind] > movers_range_m[which[behind]]
    return bool((np.isfinite(near) | behind).mean() > 0.5)
