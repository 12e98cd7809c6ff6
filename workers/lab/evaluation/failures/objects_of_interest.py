"""The things of a scene that the supervised stream can be right or wrong about, by truth.

A *failure* is a thing on which it errs: at least 25 points of it wrong, most of the thing, in
frames that together last half a second. Things are the objects of the truth, and where points
belong to none, what the wrong labels themselves make up: a phantom on a wall, a mover without box.
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
from workers.lab.evaluation.failures.frame_truth import SeenFrame

MIN_POINTS: Final = 25
MIN_S: Final = 0.5
_RIM_M: Final = 0.5
_TOLERANCE: Final = 1e-6

Points = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Thing:
    """One thing of a scene.

    Attributes:
        key: Its name in the scene: `track 7`, `phantom 0`, `missed 1`.
        track: Of the truth; -1 none.
        class_name: What truth calls it; empty where it does not say.
        moves: Whether it truly moves, in most frames.
        points: By frame of the scene, its points whose true motion is known; frames in which it
            has 25 at least.
        failing: Frames in which the supervised stream errs on most of it.
        fails: Whether these last long enough.
    """

    key: str
    track: int
    class_name: str
    moves: bool
    points: dict[int, Points]
    failing: tuple[int, ...]
    fails: bool


def frames_of(seconds: float, period_s: float) -> int:
    """How many frames last so long; one at least."""
    return max(1, ceil(seconds / period_s - _TOLERANCE)) if period_s > 0 else 1


def find_things(scene: Scene, seen: Sequence[SeenFrame]) -> list[Thing]:
    """Find what the supervised stream can be judged by in a scene.

    Args:
        scene: The labelled frames.
        seen: The same with their truth.
    """
    enough = frames_of(MIN_S, frame_period_s(scene))
    return [*_objects(seen, enough), *_of_nobody(scene, seen, enough)]


def _objects(seen: Sequence[SeenFrame], enough: int) -> Iterator[Thing]:
    points: dict[int, dict[int, Points]] = {}
    for number, frame in enumerate(seen):
        track = np.where(frame.known, frame.track, -1)
        order = np.argsort(track, kind="stable")
        ids, first = np.unique(track[order], return_index=True)
        for each, mine in zip(ids.tolist(), np.split(order, first[1:]), strict=True):
            if each >= 0 and len(mine) >= MIN_POINTS:
                points.setdefault(each, {})[number] = mine
    for track_id, by_frame in sorted(points.items()):
        if len(by_frame) < enough:
            continue
        failing = [
            number
            for number, mine in by_frame.items()
            if _errs(seen[number].wrong(seen[number].labelled.semantic)[mine])
        ]
        moving = [bool(seen[number].moving[mine].mean() > 0.5) for number, mine in by_frame.items()]
        yield Thing(
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


def _of_nobody(scene: Scene, seen: Sequence[SeenFrame], enough: int) -> Iterator[Thing]:
    """Wrong points that belong to no object, clustered and tied over frames, long enough ones."""
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
            yield Thing(f"{name} {number}", -1, "", moves, by_frame, frames, fails=True)
            number += 1


def _instances(frame: SeenFrame, number: int, candidates: Points) -> Iterator[Instance]:
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
    """Whether most points lie against a true mover: labels that bleed are no thing."""
    if not len(movers_m):
        return False
    near, _ = cKDTree(movers_m).query(points_m, distance_upper_bound=_RIM_M)
    return bool(np.isfinite(near).mean() > 0.5)
