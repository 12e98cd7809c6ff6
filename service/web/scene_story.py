"""Contents of the scene page: evidence of tracks, blindness, neighbours in time. Pure."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.contradiction import TrackRecord
from schemas.frame import OdometryState
from schemas.score import MIN_REPORTED_STRENGTH, Reason, SceneScore
from service.curation.listing import ListedScene
from service.curation.ranking import Neighbour
from service.curation.twins import ShownScene, same_thing
from service.web.phrases import percent
from service.web.scene_facts import label_of

MOST_NEIGHBOURS: Final = 7
"""Scenes before and after this one that the page shows."""

WEIGHTS: Final = (1.0, 0.78, 0.6, 0.46, 0.36, 0.28)
"""Lengths of the bars of evidence by their order; a record has the order of weights alone."""


@dataclass(frozen=True, slots=True)
class TrackStory:
    """A track as the page shows it.

    Attributes:
        track: Its record.
        label: Number and class.
        is_strong: True for a reason of the score, and for the first track in any case.
        headline: Of its reason; empty where it is no reason.
        chances: Name and probability of each attribution, the most probable first.
        supporting: Evidence for the attribution with the length of its bar, the weightiest first.
        opposing: Evidence against it.
        measured: Name and share of what was measured on it.
        first_s: Begin within the scene, seconds.
        last_s: End within the scene, seconds.
        strongest_s: Moment of its strongest evidence, seconds.
    """

    track: TrackRecord
    label: str
    is_strong: bool
    headline: str
    chances: tuple[tuple[str, float], ...]
    supporting: tuple[tuple[str, float], ...]
    opposing: tuple[tuple[str, float], ...]
    measured: tuple[tuple[str, float], ...]
    first_s: float
    last_s: float
    strongest_s: float


def stories_of(score: SceneScore) -> list[TrackStory]:
    """Return the tracks of a record, strongest first."""
    reasons = {reason.track_id: reason for reason in score.reasons}
    return [_story(score, track, reasons.get(track.track_id)) for track in score.tracks]


def blind_spots(score: SceneScore) -> list[tuple[str, str]]:
    """Return the source and a phrase for everything that a stream could not observe."""
    found: list[tuple[str, str]] = []
    health, supervised, odometry = score.health, score.supervised, score.odometry
    if supervised is not None:
        found.append(("Supervised", f"labels {percent(supervised.labelled_share)} of the returns"))
        if supervised.unanswered_share:
            share = percent(supervised.unanswered_share)
            found.append(("Supervised", f"the model gave no answer for {share} of the frames"))
        if supervised.reason:
            found.append(("Supervised", supervised.reason))
    if health is not None:
        found.append(
            ("Self-supervised", f"leaves {percent(health.unknown_share)} of the returns unlabelled")
        )
        if health.seen_share is not None:
            found.append(
                (
                    "Witness",
                    f"an earlier frame observed {percent(health.seen_share)} of the places off the "
                    "ground and in range",
                )
            )
        if health.blind_share:
            share = percent(health.blind_share)
            found.append(("Self-supervised", f"labelled no point in {share} of the frames"))
        if health.pose_jumps:
            found.append(("Poses", f"jump in {health.pose_jumps} frames as no car can move"))
        if health.reason:
            found.append(("Self-supervised", health.reason))
    found.append(("Both", f"compared on {percent(score.compared_share)} of the points"))
    if odometry.state is not OdometryState.HEALTHY or odometry.reason:
        words = f"{odometry.state.value}, {percent(odometry.healthy_share)} of the frames healthy"
        found.append(("Odometry", f"{words}: {odometry.reason}" if odometry.reason else words))
    return found


def around(rows: Iterable[ListedScene], score: SceneScore) -> list[ListedScene]:
    """Return the scenes of the same log and lidar around a scene, in time, without itself."""
    same = sorted(
        (
            row
            for row in rows
            if (row.log_id, row.lidar_topic) == (score.log_id, score.lidar_topic)
            and row.scene_id != score.scene_id
        ),
        key=lambda row: row.start_ns,
    )
    before = [row for row in same if row.start_ns < score.start_ns]
    after = [row for row in same if row.start_ns >= score.start_ns]
    return [*before[-MOST_NEIGHBOURS:], *after[:MOST_NEIGHBOURS]]


def same_things(score: SceneScore, others: Sequence[SceneScore]) -> dict[str, list[int]]:
    """Find tracks of neighbouring scenes that are the same thing as a track of this one.

    Returns:
        Ids of this scene's tracks that a neighbour shows too, by the neighbour's id.
    """
    mine = _shown(score)
    found: dict[str, list[int]] = {}
    for other in others:
        theirs = _shown(other)
        shared = [
            track.track_id
            for track in mine.tracks
            if any(same_thing(one, theirs, track, mine) for one in theirs.tracks)
        ]
        if shared:
            found[other.scene_id] = shared
    return found


def is_strong(score: SceneScore, track: TrackRecord) -> bool:
    """Return true for a track that is a reason of the score, and for the first one."""
    return track.strength >= MIN_REPORTED_STRENGTH or track is score.tracks[0]


def _shown(score: SceneScore) -> ShownScene:
    at = Neighbour(score.scene_id, score.start_ns, score.end_ns)
    return ShownScene(
        at,
        odom=(score.log_id, score.lidar_topic, score.producers.pipeline_version),
        driven_m=score.odometry.distance_m,
        tracks=tuple(track for track in score.tracks if is_strong(score, track)),
    )


def _story(score: SceneScore, track: TrackRecord, reason: Reason | None) -> TrackStory:
    found, strongest = track.attribution, track.strongest
    supporting = (reason.supporting if reason else ()) or (found.supporting if found else ())
    opposing = (reason.opposing if reason else ()) or (found.opposing if found else ())
    chances: list[tuple[str, float]] = []
    if found is not None:
        chances = [
            (name, getattr(found, name))
            for name in ("supervised", "selfsupervised", "both", "neither")
        ]
    measured = [
        ("supervised confidence", strongest.semantic_confidence),
        ("self-supervised confidence", strongest.predictive_confidence),
    ]
    if track.confirmed_share is not None:
        measured.append(("motion confirmed", track.confirmed_share))

    def seconds(stamp_ns: int) -> float:
        return (stamp_ns - score.start_ns) / NS_PER_S

    return TrackStory(
        track=track,
        label=label_of(track),
        is_strong=is_strong(score, track),
        headline=reason.headline if reason else "",
        chances=tuple(sorted(chances, key=lambda pair: -pair[1])),
        supporting=_weighted(supporting),
        opposing=_weighted(opposing),
        measured=tuple(measured),
        first_s=seconds(track.first_ns),
        last_s=seconds(track.last_ns),
        strongest_s=seconds(strongest.stamp_ns),
    )


def _weighted(phrases: Sequence[str]) -> tuple[tuple[str, float], ...]:
    return tuple(zip(phrases, WEIGHTS, strict=False))
