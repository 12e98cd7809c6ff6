"""Record of a scored scene, which is published, stored, ranked and reviewed."""

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from schemas.bounds import Finite, LogId, Name, Positive, Said, SceneId, StampNs, Tally, Text, Topic
from schemas.contradiction import KindName, SceneState, TrackRecord
from schemas.frame import OdometryState
from schemas.surroundings import CloudStatistics, ScenePlace
from schemas.task import MAX_CLASSES, MOTION, UnknownTaskError, task_named

Share = Annotated[float, Field(ge=0, le=1)]
"""A fraction, 0 to 1."""

MAX_TRACKS: Final = 32
"""Tracks of a record at most, strongest first: more would exceed MAX_RECORD_BYTES on the bus."""

MAX_RECORD_BYTES: Final = 16_896
"""Bytes of a record on the bus: 16 KiB with its tracks, and 512 bytes of its surroundings."""

MAX_SUPPORTING: Final = 3
"""Phrases of evidence for an attribution that a reason carries."""

MAX_OPPOSING: Final = 1
"""Phrases of evidence against an attribution that a reason carries."""

MIN_REPORTED_STRENGTH: Final = 0.05
"""Strength below which a track is counted in the totals and is no reason."""

SCHEMA_VERSION: Final = 2
"""Version of the records that this program writes; it reads version 1 too."""


class AgreementShares(BaseModel):
    """Share of each outcome of the task among compared points; they add up to 1, or all are 0.

    For motion: `both_static`, `both_dynamic`, `only_semantic_dynamic`, `only_predictive_dynamic`.
    """

    model_config = ConfigDict(frozen=True, extra="allow")

    __pydantic_extra__: dict[str, Share]

    def __getitem__(self, outcome: str) -> float:
        """Return the share of an outcome, by name."""
        return self.__pydantic_extra__[outcome]

    @property
    def outcomes(self) -> frozenset[str]:
        """Names of the outcomes that have a share."""
        return frozenset(self.__pydantic_extra__)


class KindTotal(BaseModel):
    """Totals of one kind of contradiction in a scene, with those that the record leaves out."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: KindName
    instances: Tally = Field(description="Instances over all frames.")
    tracks: Tally = Field(description="Tracks over the scene.")
    points: Tally = Field(description="Points over all instances.")


class OdometryHealth(BaseModel):
    """Health of a scene's poses, which gates its score."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    state: OdometryState = Field(description="The worst of the scene's frames.")
    healthy_share: Share = Field(description="Share of frames with a healthy pose.")
    static_residual_m: Finite = Field(ge=0, description="Median over the frames, metres.")
    distance_m: Finite = Field(ge=0, description="Path of the sensor over the scene, metres.")
    reason: str = Field(default="", max_length=200, description="Cause if not healthy.")


class StreamHealth(BaseModel):
    """Health of the self-supervised stream: a frame in which it is blind is no evidence."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    unknown_share: Share = Field(description="Share of the returns that it did not label.")
    seen_share: Share | None = Field(
        description="Mean share of the queried places, off the ground and in range, that an "
        "earlier frame observed or saw through; null without a query."
    )
    blind_share: Share = Field(description="Share of frames in which it labelled no point.")
    pose_jumps: Tally = Field(description="Frames whose pose moved as no car can move.")
    reason: str = Field(default="", max_length=200, description="Cause of its blindness.")


class SupervisedHealth(BaseModel):
    """Health of a recorded supervised stream that does not label everything."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    labelled_share: Share = Field(
        description="Share of the returns that it labels, and that can contradict at all."
    )
    unanswered_share: Share = Field(
        description="Share of frames for which the model gave no answer."
    )
    reason: str = Field(default="", max_length=200, description="What its answers do not state.")


class Reason(BaseModel):
    """One reason of a score: a headline, and the evidence for and against its attribution."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    headline: Text = Field(
        description="What a stream labels and what another source labels or measures, where, for "
        "how long, and which stream is wrong with which probability; or what lowered the score of "
        "the scene. One line, the same in tables, on pictures and in selections."
    )
    track_id: Tally | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="The track it is about; absent where it is about the whole scene.",
    )
    supporting: tuple[Text, ...] = Field(
        default=(),
        max_length=MAX_SUPPORTING,
        exclude_if=lambda value: not value,
        description="Strongest evidence for the attribution, strongest first.",
    )
    opposing: tuple[Text, ...] = Field(
        default=(),
        max_length=MAX_OPPOSING,
        exclude_if=lambda value: not value,
        description="Strongest evidence against it.",
    )

    @property
    def evidence(self) -> str:
        """Both lists as one phrase; empty without evidence."""
        known = (("for", self.supporting), ("against", self.opposing))
        return "; ".join(f"{how}: {', '.join(phrases)}" for how, phrases in known if phrases)

    @property
    def text(self) -> str:
        """The whole reason on one line."""
        return "; ".join(part for part in (self.headline, self.evidence) if part)


TAUGHT: Final = ":taught"
"""End of the name of a supervised stream that the self-supervised stream taught."""


def is_taught(version: str) -> bool:
    """Return True if `name@version` is of a stream that the self-supervised stream taught."""
    return version.partition("@")[0].endswith(TAUGHT)


class Producers(BaseModel):
    """Sources of the labels: name and version of each stream's model, and of the pipeline."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    supervised: Said = Field(
        description="`name@version`; the version is a digest of its weights, and a "
        "name that ends in `:taught` is of weights that the self-supervised stream taught."
    )
    selfsupervised: Said = Field(description="`name@version`.")
    pipeline_version: Name = Field(description="Digest of grid, warm-up, weights and settings.")

    @property
    def taught(self) -> bool:
        """True if the supervised stream was taught by the self-supervised one."""
        return is_taught(self.supervised)


class SceneScore(BaseModel):
    """Score of one scene by the contradictions of its two streams, with reasons and tracks.

    The record contains no processing time, worker or attempt, and its floats are rounded. The same
    shard plan, weights and settings give the same bytes
    (`schemas.transport.wire.encode_scene_score`).
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: Literal[2] = SCHEMA_VERSION
    task: Name = Field(
        default=MOTION.name,
        exclude_if=lambda value: value == MOTION.name,
        description="Task of both streams, which label each point; absent: motion.",
    )
    scene_id: SceneId = Field(description="`<log_id>/<lidar>/<start_ns>`, unique.")
    log_id: LogId = Field(description="Bucket-relative key of the recording.")
    lidar_topic: Topic = Field(description="MCAP topic of the lidar.")
    vehicle: Said = Field(description="From the log's metadata or path, else `unknown`.")
    date: Said = Field(description="From the log's metadata or path, else `unknown`.")
    software_version: Said = Field(description="From the log's metadata or path, else `unknown`.")
    start_ns: StampNs = Field(description="First frame, nanoseconds since the Unix epoch.")
    end_ns: StampNs = Field(description="Last frame, nanoseconds since the Unix epoch.")
    frames: Positive = Field(description="Frames of the scene.")
    state: SceneState = Field(description="`too_short` and `odometry_lost` have score 0.")
    score: Share = Field(description="0: no strong contradiction; towards 1: many.")
    reasons: tuple[Reason, ...] = Field(
        max_length=MAX_TRACKS,
        description="Reasons of the score, by strength; reasons that lowered it are last.",
    )
    sentences_version: Literal[1, 2] = Field(
        default=SCHEMA_VERSION,
        exclude_if=lambda value: value == SCHEMA_VERSION,
        description="Version of the words in reasons and attributions; 1: the record was written "
        "as version 1 and keeps its sentences, each as a headline; absent: 2.",
    )
    points: Tally = Field(description="Points of all frames, invalid ones included.")
    compared_share: Share = Field(description="Share of points that both streams labelled.")
    all_points: AgreementShares = Field(description="Over all compared points.")
    nonground_points: AgreementShares = Field(description="Over compared points off the ground.")
    totals: tuple[KindTotal, ...] = Field(
        max_length=MAX_CLASSES**2, description="One row per kind, all counted."
    )
    tracks: tuple[TrackRecord, ...] = Field(
        max_length=MAX_TRACKS, description="The strongest tracks, strongest first."
    )
    odometry: OdometryHealth
    health: StreamHealth | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Of the self-supervised stream; absent from records of earlier services.",
    )
    supervised: SupervisedHealth | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Of the supervised stream, where it is recorded and some frames have no answer "
        "or no motion; absent otherwise, and from records of earlier services.",
    )
    cloud: CloudStatistics | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Statistics of its clouds, which depend on the weather; absent where it has no "
        "return, and from records of earlier services.",
    )
    place: ScenePlace | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Where it was recorded; absent where its log records no global place near it, "
        "and from records of earlier services.",
    )
    producers: Producers

    @model_validator(mode="before")
    @classmethod
    def _read_version_1(cls, record: Any) -> Any:
        return from_version_1(record) if _is_of_version_1(record) else record

    @model_validator(mode="after")
    def _names_are_those_of_the_task(self) -> "SceneScore":
        try:
            task = task_named(self.task)
        except UnknownTaskError as error:
            raise ValueError(str(error)) from None
        outcomes = {outcome.name for outcome in task.compared()}
        kinds = {kind.name for kind in task.kinds}
        for shares in (self.all_points, self.nonground_points):
            if shares.outcomes != outcomes:
                raise ValueError(f"shares of task {task.name} must be of {sorted(outcomes)}")
        named = {total.kind for total in self.totals} | {track.kind for track in self.tracks}
        if unknown := named - kinds:
            raise ValueError(f"task {task.name} has no kind {sorted(unknown)}")
        return self


MOST_LABELS: Final = 10
"""Tracks that a picture labels by number and class."""


def shown_tracks(score: SceneScore, *, most: int = MOST_LABELS) -> list[TrackRecord]:
    """Return the tracks that a picture names: strong ones, and in any case the first one.

    Weaker ones have boxes without a number; they are no reason of the score.
    """
    strong = [track for track in score.tracks if track.strength >= MIN_REPORTED_STRENGTH]
    return (strong or list(score.tracks[:1]))[:most]


_OF_THE_SCENE: Final = (
    "odometry ",
    "recorded odometry ",
    "self-supervised stream ",
    "nothing was compared",
)
"""First words of the reasons of version 1 that are about the whole scene."""

_RENAMED: Final = {"because": "supporting", "against": "opposing", "also": "neutral"}
"""Fields of an attribution, version 1 to version 2."""


def from_version_1(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return a record of version 1 as one of version 2.

    Its sentences are unchanged: each is the headline of a reason, and `sentences_version` marks
    them. No number changes.
    """
    return {
        **record,
        "schema_version": SCHEMA_VERSION,
        "sentences_version": 1,
        "reasons": _reasons_from_version_1(record),
        "tracks": [_track_from_version_1(track) for track in record.get("tracks", ())],
    }


def _reasons_from_version_1(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Give each reason about a track its number: reasons and tracks have the same order."""
    tracks = len(record.get("tracks", ())) if record.get("state") == SceneState.SCORED else 0
    return [
        {"headline": reason, "track_id": number}
        if number < tracks and not str(reason).startswith(_OF_THE_SCENE)
        else {"headline": reason}
        for number, reason in enumerate(record.get("reasons", ()))
    ]


def _is_of_version_1(record: Any) -> bool:
    return isinstance(record, Mapping) and record.get("schema_version") == 1


def _track_from_version_1(track: Any) -> Any:
    attribution = track.get("attribution") if isinstance(track, Mapping) else None
    if not isinstance(attribution, Mapping):
        return track
    renamed = {_RENAMED.get(name, name): value for name, value in attribution.items()}
    return {**track, "attribution": renamed}
