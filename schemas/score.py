"""Scored scene: the record that is published, stored, ranked and reviewed."""

from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from schemas.bounds import Finite, LogId, Name, Positive, Said, SceneId, StampNs, Tally, Text, Topic
from schemas.contradiction import KindName, SceneState, TrackRecord
from schemas.frame import OdometryState
from schemas.task import MAX_CLASSES, MOTION, UnknownTaskError, task_named

Share = Annotated[float, Field(ge=0, le=1)]
"""A fraction, 0 to 1."""

MAX_TRACKS: Final = 32
"""Tracks a record carries, strongest first: keeps it under MAX_RECORD_BYTES on the bus."""

MAX_RECORD_BYTES: Final = 16_384


class AgreementShares(BaseModel):
    """Share of each outcome of the task among compared points; they add up to 1, or all are 0.

    For motion: `both_static`, `both_dynamic`, `only_semantic_dynamic`, `only_predictive_dynamic`.
    """

    model_config = ConfigDict(frozen=True, extra="allow")

    __pydantic_extra__: dict[str, Share]

    def __getitem__(self, outcome: str) -> float:
        """Share of the outcome of this name."""
        return self.__pydantic_extra__[outcome]

    @property
    def outcomes(self) -> frozenset[str]:
        """Names of all that have a share."""
        return frozenset(self.__pydantic_extra__)


class KindTotal(BaseModel):
    """Number of contradictions of one kind in a scene, including those beyond the record."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: KindName
    instances: Tally = Field(description="Instances over all frames.")
    tracks: Tally = Field(description="Tracks over the scene.")
    points: Tally = Field(description="Points over all instances.")


class OdometryHealth(BaseModel):
    """Odometry state of the scene; it gates the score."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    state: OdometryState = Field(description="The worst of the scene's frames.")
    healthy_share: Share = Field(description="Share of frames with a healthy pose.")
    static_residual_m: Finite = Field(ge=0, description="Median over the frames, metres.")
    distance_m: Finite = Field(ge=0, description="Path of the sensor over the scene, metres.")
    reason: str = Field(default="", max_length=200, description="Why not healthy, if so.")


class StreamHealth(BaseModel):
    """Input quality of the self-supervised stream; it distinguishes silence from blindness."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    unknown_share: Share = Field(description="Share of the returns that it did not judge.")
    seen_share: Share | None = Field(
        description="Mean share of what it was asked about, off the ground and in reach, that an "
        "earlier frame saw or saw through; null if it was never asked."
    )
    blind_share: Share = Field(description="Share of frames in which it judged nothing.")
    pose_jumps: Tally = Field(description="Frames whose pose went where no car goes.")
    reason: str = Field(default="", max_length=200, description="Why it was blind, if it was.")


class Producers(BaseModel):
    """Name and version of each stream's model."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    supervised: Said = Field(description="`name@version`; the version is a digest of its weights.")
    selfsupervised: Said = Field(description="`name@version`.")
    pipeline_version: Name = Field(description="Digest of grid, warm-up, weights and settings.")


class SceneScore(BaseModel):
    """Score of one scene: the amount of contradiction between the two streams.

    It contains no processing time, worker or attempt, and floats are rounded. The same shard plan,
    weights and settings give the same bytes (`schemas.transport.wire.encode_scene_score`).
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: Literal[1] = 1
    task: Name = Field(
        default=MOTION.name,
        exclude_if=lambda value: value == MOTION.name,
        description="What both streams were asked about each point; absent: motion.",
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
    score: Share = Field(description="0: no contradiction worth a look; towards 1: many strong.")
    reasons: tuple[Text, ...] = Field(
        max_length=MAX_TRACKS, description="What made the score, in words; strongest first."
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
    producers: Producers

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
        said = {total.kind for total in self.totals} | {track.kind for track in self.tracks}
        if unknown := said - kinds:
            raise ValueError(f"task {task.name} has no kind {sorted(unknown)}")
        return self
