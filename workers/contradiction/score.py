"""Score of a scene, combined from its tracks, and the record that is published.

    score = 1 - (1 - s1)(1 - s2 / 2)(1 - s3 / 4) ...

s1 >= s2 >= ... are the strengths of the scene's tracks (`track_score.py`). They are already reduced
by poses that were doubted in the frames of the track.

The score is 0 without a contradiction, always below 1, and at least the strength of the strongest
track, so that one clear failure is enough. It never falls when a track is added or grows. Each
further track counts half of the one before. A plain noisy-or would be near 1 for every scene of a
mediocre supervised network, which leaves a hundred small contradictions everywhere. Here any number
of tracks of strength 0.2 stays below 0.35, under one clear track of 0.5.

Scenes in state `too_short` or `odometry_lost` (mean weight of the poses below 1/2) have score 0,
and their tracks have strength 0. They are listed last and never ranked.
"""

import math
from collections.abc import Sequence
from typing import Final, Protocol

from schemas.attribution import Attribution
from schemas.contradiction import (
    Instance,
    InstanceRecord,
    Place,
    Scene,
    SceneState,
    TrackRecord,
)
from schemas.score import (
    MAX_RECORD_BYTES,
    MAX_TRACKS,
    MIN_REPORTED_STRENGTH,
    KindTotal,
    Producers,
    SceneScore,
)
from schemas.task import Outcome
from schemas.transport.wire import encode
from schemas.work import Shard
from workers.contradiction.origin import Origin
from workers.contradiction.reasons import class_word, reasons_of
from workers.contradiction.scene_statistics import SceneStatistics, statistics_of
from workers.contradiction.score_settings import DEFAULT_SCORE, ScoreSettings
from workers.contradiction.track_score import RankedTrack, pose_weights

TRACKS_BYTES: Final = 16_384
"""Bytes of a record with its tracks and without its surroundings."""


class Versioned(Protocol):
    """A part with a version that changes with its output."""

    @property
    def version(self) -> str:
        """`name@digest`."""
        ...


class Streams(Protocol):
    """The members of `workers.parts.protocols.Parts` that a record names."""

    @property
    def supervised(self) -> Versioned:
        """The supervised stream."""
        ...

    @property
    def selfsupervised(self) -> Versioned:
        """The self-supervised stream."""
        ...

    @property
    def own_model(self) -> str:
        """Name of the user's own model; empty where the supervised stream is a shipped one."""
        ...


def score_scene(
    shard: Shard,
    scene: Scene,
    instances: Sequence[Instance],
    ranked: Sequence[RankedTrack],
    *,
    parts: Streams,
    pipeline_version: str,
    statistics: SceneStatistics | None = None,
    settings: ScoreSettings = DEFAULT_SCORE,
) -> SceneScore:
    """Score one scene and build its record.

    Args:
        shard: Shard of the scene, which names the log, the vehicle and the software.
        scene: Its labelled frames.
        instances: Its instances, from `find_instances`.
        ranked: Their tracks, from `rank_tracks`.
        parts: The streams that labelled it, for their versions.
        pipeline_version: Digest of everything that changes a record.
        statistics: Statistics of the scene; None: computed here.
        settings: Constants of the score.

    Returns:
        The record, which fits the bus: with very long names it has fewer than 32 tracks.
    """
    return record_of(
        *(Origin.of(shard), scene, statistics or statistics_of(scene), instances, ranked),
        producers=Producers(
            supervised=parts.supervised.version,
            selfsupervised=parts.selfsupervised.version,
            pipeline_version=pipeline_version,
        ),
        own_model=parts.own_model,
        settings=settings,
    )


def record_of(
    origin: Origin,
    scene: Scene,
    statistics: SceneStatistics,
    instances: Sequence[Instance],
    ranked: Sequence[RankedTrack],
    *,
    producers: Producers,
    own_model: str,
    settings: ScoreSettings = DEFAULT_SCORE,
) -> SceneScore:
    """Score one scene by its statistics and tracks; the points of its frames are not used.

    Args:
        origin: Log, lidar, vehicle and software of the scene.
        scene: The scene.
        statistics: Its statistics.
        instances: Its instances.
        ranked: Their tracks.
        producers: Versions of the streams and of the pipeline.
        own_model: Name of the user's own model; empty where the supervised stream is a shipped one.
        settings: Constants of the score.
    """
    state = judge_odometry(scene, settings=settings)
    counts = 1.0 if state is SceneState.SCORED else 0.0
    shares = statistics.shares
    record = SceneScore(
        task=scene.task.name,
        scene_id=scene.scene_id,
        log_id=origin.log_id,
        lidar_topic=origin.lidar_topic,
        vehicle=origin.vehicle,
        date=origin.date,
        software_version=origin.software_version,
        start_ns=scene.start_ns,
        end_ns=scene.end_ns,
        frames=len(scene.frames),
        state=state,
        score=combine([counts * each.strength for each in ranked], decay=settings.decay),
        reasons=reasons_of(
            *(scene, instances, ranked),
            state=state,
            statistics=statistics,
            own_model=own_model,
            taught=producers.taught,
        ),
        points=shares.points,
        compared_share=shares.compared_share,
        all_points=shares.all_points,
        nonground_points=shares.nonground_points,
        totals=tuple(_total(kind, instances, ranked) for kind in scene.task.kinds),
        tracks=tuple(
            _track_record(scene, instances, each, track_id=track_id, counts=counts)
            for track_id, each in enumerate(ranked[:MAX_TRACKS])
        ),
        odometry=statistics.odometry,
        health=statistics.stream,
        supervised=statistics.supervised,
        cloud=statistics.cloud,
        place=statistics.place,
        producers=producers,
    )
    return _fit(record)


def combine(strengths: Sequence[float], *, decay: float) -> float:
    """Combine strengths to one score in [0, 1); order does not matter.

    Args:
        strengths: Each in [0, 1).
        decay: Weight of each track relative to the stronger one before it.
    """
    remaining = math.prod(
        1.0 - strength * decay**rank
        for rank, strength in enumerate(sorted(strengths, reverse=True))
    )
    return min(round(1.0 - remaining, 4), 0.9999)


def judge_odometry(scene: Scene, *, settings: ScoreSettings = DEFAULT_SCORE) -> SceneState:
    """Return the state of a scene's score, from its length and the weights of its poses."""
    if scene.too_short:
        return SceneState.TOO_SHORT
    if float(pose_weights(scene, settings=settings).mean()) < settings.lost_below:
        return SceneState.ODOMETRY_LOST
    return SceneState.SCORED


def _total(
    kind: Outcome, instances: Sequence[Instance], ranked: Sequence[RankedTrack]
) -> KindTotal:
    mine = [instance for instance in instances if instance.kind == kind]
    return KindTotal(
        kind=kind.name,
        instances=len(mine),
        tracks=sum(each.track.kind == kind for each in ranked),
        points=sum(len(instance.point_index) for instance in mine),
    )


def _track_record(
    scene: Scene,
    instances: Sequence[Instance],
    ranked: RankedTrack,
    *,
    track_id: int,
    counts: float,
) -> TrackRecord:
    members = ranked.track.members
    strength = round(counts * ranked.strength, 4)
    first, last = instances[members[0]], instances[members[-1]]
    is_reported = strength >= MIN_REPORTED_STRENGTH
    return TrackRecord(
        track_id=track_id,
        kind=ranked.track.kind.name,
        class_name=class_word(ranked.class_name),
        strength=strength,
        first_ns=scene.frames[first.frame_index].stamp_ns,
        last_ns=scene.frames[last.frame_index].stamp_ns,
        frames=len(members),
        points=ranked.points,
        speed_m_per_s=ranked.speed_m_per_s,
        first_odom_m=_odom_m(scene, first) if is_reported else None,
        last_odom_m=_odom_m(scene, last) if is_reported else None,
        confirmed_share=(
            None if ranked.confirmed_share is None else _round(ranked.confirmed_share, 3)
        ),
        attribution=ranked.attribution if is_reported else _without_evidence(ranked.attribution),
        strongest=_instance_record(scene, instances[ranked.strongest]),
    )


def _odom_m(scene: Scene, instance: Instance) -> Place:
    """Return the centre of an instance in odom space, to a tenth of a metre."""
    odom_from_sensor = scene.frames[instance.frame_index].posed.odom_from_sensor
    x_m, y_m, z_m = odom_from_sensor[:3, :3] @ instance.centre_m + odom_from_sensor[:3, 3]
    return _round(x_m, 1), _round(y_m, 1), _round(z_m, 1)


def _without_evidence(attribution: Attribution | None) -> Attribution | None:
    """Return the attribution of a weak track, without its evidence, so that the record fits."""
    if attribution is None:
        return None
    return attribution.model_copy(update={"supporting": (), "opposing": (), "neutral": ()})


def _instance_record(scene: Scene, instance: Instance) -> InstanceRecord:
    x_m, y_m, z_m = (_round(value, 2) for value in instance.centre_m)
    length_m, width_m, height_m = (_round(value, 2) for value in instance.size_m)
    return InstanceRecord(
        stamp_ns=scene.frames[instance.frame_index].stamp_ns,
        points=len(instance.point_index),
        centre_m=(x_m, y_m, z_m),
        size_m=(length_m, width_m, height_m),
        yaw_rad=_round(instance.yaw_rad, 3),
        range_m=_round(math.hypot(float(instance.centre_m[0]), float(instance.centre_m[1])), 2),
        semantic_confidence=_round(instance.semantic_confidence, 3),
        predictive_confidence=_round(instance.predictive_confidence, 3),
    )


def _round(value: float, digits: int) -> float:
    return round(float(value), digits) + 0.0  # never -0.0, which is another text


def _fit(record: SceneScore) -> SceneScore:
    """Fit the record to the bus: drop the evidence of weak tracks, then the weakest tracks.

    `totals` count every track in any case. Surroundings have room of their own, so that a record
    has the same tracks with them and without.
    """
    bare = record.model_copy(update={"cloud": None, "place": None})
    room = min(MAX_RECORD_BYTES - len(encode(record)) + len(encode(bare)), TRACKS_BYTES)
    fitted = _fit_tracks(bare, room)
    return record.model_copy(update={"tracks": fitted.tracks})


def _fit_tracks(record: SceneScore, most_bytes: int) -> SceneScore:
    for index in reversed(range(len(record.tracks))):
        if len(encode(record)) <= most_bytes:
            return record
        tracks = list(record.tracks)
        attribution = _without_evidence(tracks[index].attribution)
        tracks[index] = tracks[index].model_copy(update={"attribution": attribution})
        record = record.model_copy(update={"tracks": tuple(tracks)})
    while record.tracks and len(encode(record)) > most_bytes:
        record = record.model_copy(update={"tracks": record.tracks[:-1]})
    return record
