"""One log, mined as a worker would and compared with its truth, scene by scene."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from schemas.arrays import NS_PER_S
from schemas.attribution import Wrong
from schemas.bucket import Bucket
from schemas.contradiction import Instance, Scene
from schemas.mining import MiningSettings
from schemas.work import Recording
from workers.contradiction.strength import rank_tracks
from workers.evaluation.failures.rows import OTHER_KIND, MinedLog, SceneRow, ThingRow, TrackRow
from workers.evaluation.failures.seen import SeenFrame, TellsUnsureness
from workers.evaluation.failures.slips import Slip, SlippingOdometry
from workers.evaluation.failures.thing_views import thing_views
from workers.evaluation.failures.things import MIN_POINTS, Thing, find_things
from workers.evaluation.failures.verdicts import thing_under, verdict_of
from workers.evaluation.failures.views import views_of
from workers.evaluation.truth import LogTruth, TruthUnusableError
from workers.evaluation.whole_log import shards_of_log
from workers.ingest.read import read_shard
from workers.pipeline import MinedScene, mine_shard
from workers.protocols import Parts
from workers.simulation.plan import DisturbanceKind, FailureKind
from workers.simulation.planted_truth import FailureRow, PlantedTruth
from workers.version import pipeline_version


@dataclass(frozen=True, slots=True)
class LogJob:
    """A log that is to be mined.

    Attributes:
        recording: The log.
        truth: Folder of the truth of its bucket.
        frames: How many its truth knows.
        slips: What is put into its poses beside those that its truth lists.
    """

    recording: Recording
    truth: Path
    frames: int = 0
    slips: tuple[Slip, ...] = ()


def planted_beside(recording: Recording, truth: Path) -> PlantedTruth:
    """Read what was planted in a log; nothing where its truth does not say."""
    folder = truth / recording.log_id
    return PlantedTruth.beside(folder) or PlantedTruth()


def slips_in(planted: PlantedTruth) -> tuple[Slip, ...]:
    """Which slips of the odometry the truth of a log asks for."""
    return tuple(
        Slip(each.start_ns, each.end_ns, each.strength, each.shift_m)
        for each in planted.disturbances
        if each.kind is DisturbanceKind.ODOMETRY_SLIP
    )


def mine_log(
    bucket: Bucket,
    job: LogJob,
    settings: MiningSettings,
    parts: Parts,
    *,
    on_frames: Callable[[int], None] = lambda frames: None,
) -> MinedLog:
    """Mine a log and judge what was found.

    Args:
        bucket: Where it lies.
        job: The log, its truth, and what slips.
        settings: How it is mined.
        parts: Odometry, streams, and whoever else has an opinion.
        on_frames: Told how many frames each scene had, as it is done.

    Raises:
        TruthUnusableError: If the log has no truth, or that of another log.
        LogUnusableError: If it cannot be mined.
    """
    recording = job.recording
    truth = LogTruth.beside(recording, job.truth)
    if truth is None:
        raise TruthUnusableError(f"{recording.log_id} has no truth in {job.truth}")
    planted = planted_beside(recording, job.truth)
    slips = (*slips_in(planted), *job.slips)
    if slips:
        parts = replace(parts, odometry=SlippingOdometry(parts.odometry, slips))
    version = pipeline_version(settings, parts)
    scenes: list[SceneRow] = []
    frames, shown = 0, set[int]()
    told = parts.supervised if isinstance(parts.supervised, TellsUnsureness) else None
    for shard in shards_of_log(bucket, recording, settings, topic=truth.topic):
        reader = read_shard(bucket, recording, shard, settings)
        for mined in mine_shard(shard, reader.frames(), parts, pipeline_version=version):
            seen = _with_truth(mined.scene, truth, before=frames, told=told)
            cell = (mined.scene.start_ns - shard.anchor_ns) // round(
                settings.grid.scene_s * NS_PER_S
            )
            row, found = _scene_row(mined, seen, planted, int(cell))
            shown |= found
            scenes.append(row)
            frames += len(mined.scene.frames)
            on_frames(len(mined.scene.frames))
    return MinedLog(
        log_id=recording.log_id,
        frames=frames,
        scenes=tuple(scenes),
        planted=len(planted.failures),
        unseen=len(planted.failures) - len(shown),
        pipeline_version=version,
    )


def _with_truth(
    scene: Scene, truth: LogTruth, *, before: int, told: TellsUnsureness | None
) -> list[SeenFrame]:
    seen = []
    for number, labelled in enumerate(scene.frames):
        frame = labelled.posed.frame
        place = truth.number_of(frame, position=before + number)
        unsure = {} if told is None else told.take(frame.stamp_ns)
        seen.append(SeenFrame(labelled, truth.of(frame, number=place), unsure))
    return seen


def _scene_row(
    mined: MinedScene, seen: Sequence[SeenFrame], planted: PlantedTruth, cell: int
) -> tuple[SceneRow, set[int]]:
    scene = mined.scene
    things = find_things(scene, seen)
    rows, shown = [], set[int]()
    for thing in things:
        due = _planted_as(thing, scene, planted) if thing.fails else None
        if due is not None:
            shown.add(due)
        rows.append(_thing_row(thing, seen, None if due is None else planted.failures[due]))
    tracks, strays = _track_rows(mined, seen, things)
    disturbance = next((each.kind for each in planted.disturbances if each.scene == cell), "")
    row = SceneRow(
        scene_id=scene.scene_id,
        start_ns=scene.start_ns,
        cell=cell,
        state=mined.score.state.value,
        score=mined.score.score,
        seconds=round((scene.end_ns - scene.start_ns) / NS_PER_S, 3),
        blind_share=0.0 if mined.score.health is None else mined.score.health.blind_share,
        views=_rounded(views_of(scene)),
        things=tuple(rows + strays),
        tracks=tuple(tracks),
        disturbance=str(disturbance),
        hard=planted.hard,
    )
    return row, shown


def _planted_as(thing: Thing, scene: Scene, planted: PlantedTruth) -> int | None:
    """Which planted failure a failing thing is: its track or partner, or a ghost, at the time."""
    stamps = [scene.frames[number].stamp_ns for number in thing.failing]
    for number, each in enumerate(planted.failures):
        during = sum(each.start_ns <= stamp < each.end_ns for stamp in stamps)
        mine = thing.track >= 0 and thing.track in (each.track, each.other_track)
        ghost = each.kind is FailureKind.GHOST_MOVER and thing.track < 0 and not thing.moves
        limit = each.kind is FailureKind.RANGE_LIMIT and thing.moves
        if 2 * during > len(stamps) and (mine or ghost or limit):
            return number
    return None


def _thing_row(thing: Thing, seen: Sequence[SeenFrame], planted: FailureRow | None) -> ThingRow:
    numbers = thing.failing if thing.fails else tuple(thing.points)
    wrong = points = 0
    for number in numbers:
        mine = thing.points[number]
        points += len(mine)
        wrong += int(seen[number].wrong(seen[number].labelled.predictive)[mine].sum())
    kind = "" if not thing.fails else OTHER_KIND if planted is None else planted.kind.value
    sizes = [len(mine) for mine in thing.points.values()]
    return ThingRow(
        key=thing.key,
        track=thing.track,
        class_name=thing.class_name,
        moves=thing.moves,
        frames=len(thing.points),
        points=int(np.median(sizes)),
        fails=thing.fails,
        kind=kind,
        common_mode=planted is not None and planted.common_mode and thing.track == planted.track,
        other_wrong_share=round(wrong / points, 4) if points else 0.0,
        views=_rounded(thing_views(thing.points, seen)),
    )


def _track_rows(
    mined: MinedScene, seen: Sequence[SeenFrame], things: Sequence[Thing]
) -> tuple[list[TrackRow], list[ThingRow]]:
    """Rows of the contradicting tracks, and of what they lie on where that is no thing yet.

    A stray is what the supervised stream is right about, or too little to be a failure.
    """
    rows: list[TrackRow] = []
    strays: list[ThingRow] = []
    ranked = rank_tracks(mined.scene, mined.instances)
    for each, record in zip(ranked, mined.score.tracks, strict=False):
        members = [mined.instances[member] for member in each.track.members]
        key, track = thing_under(members, seen, things)
        verdict = verdict_of(members, seen, track=track)
        if not key and verdict in (Wrong.SELFSUPERVISED, Wrong.NEITHER):
            stray = _stray(f"stray {len(strays)}", members, seen, track)
            strays.append(stray)
            key = stray.key
        rows.append(
            TrackRow(
                kind=each.track.kind.name,
                strength=record.strength,
                frames=len(members),
                points=each.points,
                thing=key,
                true_track=track,
                verdict=verdict,
                said=record.attribution,
            )
        )
    return rows, strays


def _stray(
    key: str, members: Sequence[Instance], seen: Sequence[SeenFrame], track: int
) -> ThingRow:
    points = {each.frame_index: each.point_index for each in members}
    wrong = total = moving = 0
    for number, mine in points.items():
        total += len(mine)
        wrong += int(seen[number].wrong(seen[number].labelled.predictive)[mine].sum())
        moving += int(seen[number].moving[mine].sum())
    sizes = [len(mine) for mine in points.values()]
    return ThingRow(
        key=key,
        track=track,
        class_name=seen[members[0].frame_index].class_of(track) if track >= 0 else "",
        moves=2 * moving > total,
        frames=sum(size >= MIN_POINTS for size in sizes),
        points=int(np.median(sizes)),
        fails=False,
        other_wrong_share=round(wrong / total, 4) if total else 0.0,
        views=_rounded(thing_views(points, seen)),
    )


def _rounded(views: Mapping[str, float]) -> dict[str, float]:
    return {name: round(float(value), 6) for name, value in views.items()}
