"""Rows of one scene: contradicting tracks, objects of interest, and true verdicts on the tracks."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Mask, Transform
from schemas.attribution import Wrong
from schemas.contradiction import Instance, Scene, SceneState
from workers.contradiction.reasons import class_word
from workers.lab.evaluation.failures.baseline_scores import scene_baselines
from workers.lab.evaluation.failures.frame_truth import FrameWithTruth
from workers.lab.evaluation.failures.nearest_points import NearestPoints
from workers.lab.evaluation.failures.object_views import object_baselines
from workers.lab.evaluation.failures.objects_of_interest import (
    MIN_POINTS,
    ObjectOfInterest,
    find_objects,
)
from workers.lab.evaluation.failures.rows import OTHER_KIND, ObjectRow, SceneRow, TrackRow
from workers.lab.evaluation.failures.verdicts import object_under, verdict_of
from workers.lab.simulation.faults.fault_truth import FailureRow, PlantedTruth
from workers.lab.simulation.faults.plan import FailureKind
from workers.pipeline import MinedScene


def scene_row(
    mined: MinedScene,
    seen: Sequence[FrameWithTruth],
    planted: PlantedTruth,
    cell: int,
    *,
    nearest: NearestPoints | None = None,
) -> tuple[SceneRow, set[int]]:
    """Compare a mined scene with its truth.

    Args:
        mined: The scene with its record.
        seen: Its frames with their truth.
        planted: Failures and disturbances planted in its log.
        cell: Number of the scene in its log.
        nearest: Nearest points of its frames, where many variants of a drive share them.

    Returns:
        Its row, and the planted failures that its labels show.
    """
    scene = mined.scene
    things = find_objects(scene, seen)
    rows, shown = [], set[int]()
    other_wrong = [frame.wrong(frame.labelled.predictive) for frame in seen]
    for thing in things:
        due = _planted_match(thing, scene, planted) if thing.fails else None
        if due is not None:
            shown.add(due)
        rows.append(
            _object_row(thing, seen, None if due is None else planted.failures[due], other_wrong)
        )
    scored = mined.score.state is SceneState.SCORED
    counts = 1.0 if scored else 0.0
    tracks, strays = _track_rows(mined, seen, things, other_wrong, counts=counts)
    disturbance = next((each.kind for each in planted.disturbances if each.scene == cell), "")
    row = SceneRow(
        scene_id=scene.scene_id,
        start_ns=scene.start_ns,
        cell=cell,
        state=mined.score.state.value,
        score=mined.score.score,
        seconds=round((scene.end_ns - scene.start_ns) / NS_PER_S, 3),
        blind_share=0.0 if mined.score.health is None else mined.score.health.blind_share,
        views=_rounded(scene_baselines(scene, nearest)),
        things=tuple(rows + strays),
        tracks=tuple(tracks),
        disturbance=str(disturbance),
        hard=planted.hard,
    )
    return row, shown


def _planted_match(thing: ObjectOfInterest, scene: Scene, planted: PlantedTruth) -> int | None:
    """Match a failing object to a planted failure by track, partner track or ghost, and time."""
    stamps = [scene.frames[number].stamp_ns for number in thing.failing]
    for number, each in enumerate(planted.failures):
        during = sum(each.start_ns <= stamp < each.end_ns for stamp in stamps)
        mine = thing.track >= 0 and thing.track in (each.track, each.other_track)
        ghost = each.kind is FailureKind.GHOST_MOVER and thing.track < 0 and not thing.moves
        limit = each.kind is FailureKind.RANGE_LIMIT and thing.moves
        if 2 * during > len(stamps) and (mine or ghost or limit):
            return number
    return None


def _object_row(
    thing: ObjectOfInterest,
    seen: Sequence[FrameWithTruth],
    planted: FailureRow | None,
    other_wrong: Sequence[Mask],
) -> ObjectRow:
    numbers = thing.failing if thing.fails else tuple(thing.points)
    wrong = points = 0
    for number in numbers:
        mine = thing.points[number]
        points += len(mine)
        wrong += int(other_wrong[number][mine].sum())
    kind = "" if not thing.fails else OTHER_KIND if planted is None else planted.kind.value
    sizes = [len(mine) for mine in thing.points.values()]
    return ObjectRow(
        key=thing.key,
        track=thing.track,
        class_name=thing.class_name,
        moves=thing.moves,
        frames=sum(size >= MIN_POINTS for size in sizes),
        points=int(np.median(sizes)),
        fails=thing.fails,
        kind=kind,
        common_mode=planted is not None and planted.common_mode and thing.track == planted.track,
        other_wrong_share=round(wrong / points, 4) if points else 0.0,
        views=_rounded(object_baselines(thing.points, seen)),
    )


def _track_rows(
    mined: MinedScene,
    seen: Sequence[FrameWithTruth],
    things: Sequence[ObjectOfInterest],
    other_wrong: Sequence[Mask],
    *,
    counts: float,
) -> tuple[list[TrackRow], list[ObjectRow]]:
    """Build rows of the contradicting tracks, and of objects below them that are not listed yet.

    Such a stray is an object that the stream labels correctly, or a failure that is too small.
    """
    rows: list[TrackRow] = []
    strays: list[ObjectRow] = []
    for each in mined.tracks:
        members = [mined.instances[member] for member in each.track.members]
        key, track = object_under(members, seen, things)
        verdict = verdict_of(members, seen, track=track)
        if not key and verdict in (Wrong.SELFSUPERVISED, Wrong.NEITHER):
            stray = _stray(f"stray {len(strays)}", members, seen, track, other_wrong)
            strays.append(stray)
            key = stray.key
        middle = members[len(members) // 2]
        rows.append(
            TrackRow(
                kind=each.track.kind.name,
                strength=round(counts * each.strength, 4),
                presence=each.presence,
                gate=counts * each.gate,
                frames=len(members),
                points=each.points,
                thing=key,
                true_track=track,
                verdict=verdict,
                said=each.attribution,
                evidence=each.features.named(),
                first_frame=members[0].frame_index,
                place_m=_place(middle, seen[middle.frame_index].labelled.posed.odom_from_sensor),
                size_m=_three(middle.size_m),
                class_name=class_word(each.class_name),
                strongest_m=_three(mined.instances[each.strongest].centre_m),
                speed_m_per_s=each.speed_m_per_s,
            )
        )
    return rows, strays


def _stray(
    key: str,
    members: Sequence[Instance],
    seen: Sequence[FrameWithTruth],
    track: int,
    other_wrong: Sequence[Mask],
) -> ObjectRow:
    points = {each.frame_index: each.point_index for each in members}
    moving = np.concatenate([seen[number].moving[mine] for number, mine in points.items()])
    thing = ObjectOfInterest(
        key=key,
        track=track,
        class_name=seen[members[0].frame_index].class_of(track) if track >= 0 else "",
        moves=bool(2 * moving.sum() > len(moving)),
        points=points,
        failing=(),
        fails=False,
    )
    return _object_row(thing, seen, None, other_wrong)


def _place(instance: Instance, odom_from_sensor: Transform) -> tuple[float, float, float]:
    return _three(odom_from_sensor[:3, :3] @ instance.centre_m + odom_from_sensor[:3, 3])


def _three(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 2) for value in values)
    return x, y, z


def _rounded(views: Mapping[str, float]) -> dict[str, float]:
    return {name: round(float(value), 6) for name, value in views.items()}
