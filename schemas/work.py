"""Messages between service and workers: leases, plans, commits.

The worker asks and the service answers (`schemas.transport.keys.control`), one message each way. An
answer to `commit` comes after the database transaction, never before.
"""

import hashlib
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from schemas.bounds import (
    MAX_CHUNKS,
    MAX_INTEGER,
    MAX_PARTS,
    MAX_SCENES_OF_A_SHARD,
    MAX_SHARDS_OF_A_PLAN,
    Count,
    Finite,
    LogId,
    Name,
    Said,
    SceneId,
    Seconds,
    StampNs,
    Tally,
    Text,
    Topic,
    Url,
)
from schemas.camera import CameraCalibration
from schemas.canonical import canonical_json
from schemas.layers import Layers as Layers
from schemas.layers import ManifestEntry as ManifestEntry
from schemas.layers import RescoredShard as RescoredShard
from schemas.log_sources import BoxSource as BoxSource
from schemas.log_sources import Channel as Channel
from schemas.log_sources import FurtherLidar as FurtherLidar
from schemas.log_sources import RecordedSource as RecordedSource
from schemas.mining import MAX_JOINED
from schemas.score import MAX_RECORD_BYTES

_STRICT = ConfigDict(frozen=True, extra="forbid")

MAX_TOPICS: Final = 256
"""Lidars of one log."""


def _fits_the_bus(record: str) -> str:
    if len(record.encode()) > MAX_RECORD_BYTES:
        raise ValueError(f"a record has at most {MAX_RECORD_BYTES} bytes")
    return record


RecordText = Annotated[str, Field(max_length=MAX_RECORD_BYTES), AfterValidator(_fits_the_bus)]
"""A scored record as text, no larger than one on the bus."""


class Part(BaseModel):
    """One object of a recording, identified by key, size and etag."""

    model_config = _STRICT

    key: Url = Field(min_length=1)
    size: Count
    etag: Url


class Recording(BaseModel):
    """One log in the bucket: one MCAP file, or the parts of a split recording."""

    model_config = _STRICT

    log_id: LogId = Field(description="Key without extension and split number.")
    parts: tuple[Part, ...] = Field(
        fail_fast=True,
        min_length=1,
        max_length=MAX_PARTS,
        description="In the order of their numbers.",
    )

    @property
    def revision(self) -> str:
        """Digest of keys, sizes and etags; part of the ledger's key, never of a scored record."""
        return hashlib.sha256(
            canonical_json([part.model_dump(mode="json") for part in self.parts])
        ).hexdigest()[:16]


class ChunkRef(BaseModel):
    """Byte range with messages: an MCAP Chunk record, or a run of records outside any chunk."""

    model_config = _STRICT

    kind: Literal["chunk", "records"] = "chunk"
    part: int = Field(ge=0, lt=MAX_PARTS, description="Index into the recording's parts.")
    offset: Count = Field(description="First byte of the record(s) in that part.")
    length: int = Field(gt=0, le=MAX_INTEGER, description="Bytes to read.")
    start_ns: StampNs = Field(description="Earliest log time inside.")
    end_ns: StampNs = Field(description="Latest log time inside.")


class Shard(BaseModel):
    """A time window of one lidar of one log, with its chunks; the unit that a worker leases.

    Messages are assigned by frame stamp. Those in [start_ns, end_ns) are scored, and those from
    `warmup_start_ns` on only warm up the streams. Those until `lookahead_end_ns` only decide if a
    short last piece belongs to this shard, and the last labels of streams that look ahead.
    """

    model_config = _STRICT

    log_id: LogId
    index: int = Field(ge=0, lt=MAX_SHARDS_OF_A_PLAN)
    lidar: Channel
    further: tuple[FurtherLidar, ...] = Field(
        default=(),
        max_length=MAX_JOINED,
        exclude_if=lambda value: not value,
        description="Further lidars, joined to the frames of the lidar.",
    )
    recorded: RecordedSource | None = None
    motion: Channel | None = Field(
        default=None, description="Recorded motion of the car, if there is any."
    )
    fixes: Channel | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Recorded global places of the car, if there are any.",
    )
    camera: CameraCalibration | None = None
    has_cameras: bool = Field(
        default=False,
        exclude_if=lambda value: not value,
        description="The log is indexed and has compressed images, of which pictures may be kept.",
    )
    anchor_ns: StampNs = Field(description="First frame of the log: origin of the grid.")
    warmup_start_ns: StampNs
    start_ns: StampNs
    end_ns: StampNs = Field(description="First instant after the window.")
    lookahead_end_ns: StampNs = Field(description="Equal to end_ns where none is needed.")
    before_lookahead_end_ns: StampNs = Field(
        default=0, description="`lookahead_end_ns` of the shard before; 0 where none is."
    )
    scene_s: float = Field(default=2.0, gt=0, le=3600, description="Length of a scene.")
    first_of_log: bool = False
    last_of_log: bool = False
    chunks: tuple[ChunkRef, ...] = Field(fail_fast=True, max_length=MAX_CHUNKS)
    needed_bytes: Tally = Field(description="Stored bytes of chunks with scored messages.")
    by_log_time: bool = Field(
        default=False, description="Frame time is the log time: the sensor's clock jumped."
    )
    intensity_scale: Finite = Field(default=1.0, gt=0, description="Recorded value that means 1.")
    vehicle: Said = "unknown"
    date: Said = "unknown"
    software_version: Said = "unknown"

    @property
    def lidar_name(self) -> str:
        """Lidar topic in the form of scene ids and shard names."""
        return self.lidar.topic.strip("/").replace(".", "%2E").replace("/", ".")

    @property
    def name(self) -> str:
        """Name that is unique within the log, for one grid."""
        return f"{self.lidar_name}-{self.index:05d}"


class Damage(BaseModel):
    """A stretch of a log that cannot be read; the rest of the log is still mined."""

    model_config = _STRICT

    key: Text = Field(default="", description="Object it lies in.")
    offset: Count
    bytes: Count
    what: Text

    @property
    def is_notice(self) -> bool:
        """Return true if it costs no byte of the log, such as a fault of a model's answers."""
        return not self.bytes


class LogPlan(BaseModel):
    """Plan of a recording: its shards, and the stretches that cannot be read or used."""

    model_config = _STRICT

    log_id: LogId
    vehicle: Said = "unknown"
    date: Said = "unknown"
    software_version: Said = "unknown"
    lidar_topics: tuple[Topic, ...] = Field(fail_fast=True, default=(), max_length=MAX_TOPICS)
    shards: tuple[Shard, ...] = Field(fail_fast=True, default=(), max_length=MAX_SHARDS_OF_A_PLAN)
    damage: tuple[Damage, ...] = Field(fail_fast=True, default=(), max_length=MAX_CHUNKS)
    truncated_parts: Tally = Field(
        default=0, description="Objects that were never closed, and are used up to their end."
    )
    refused: Text = Field(
        default="", description="Cause for which the log cannot be mined; empty when it can."
    )
    range_reads: Tally = 0
    bytes_read: Tally = 0


class ClaimRequest(BaseModel):
    """Request of a worker for a lease."""

    model_config = _STRICT

    worker_id: Name
    pipeline_version: Name
    layers: Layers | None = Field(
        default=None, description="Digests that make the version; absent: nothing is reused."
    )


class PlanLease(BaseModel):
    """The right, until it expires, to plan one recording."""

    model_config = _STRICT

    kind: Literal["plan"] = "plan"
    lease_id: Name
    expires_s: Seconds
    recording: Recording
    settled: bool = Field(
        default=True,
        description="False: listed a moment ago, it may still grow; plan it only if every part "
        "ends in a valid footer, else fail with `growing`.",
    )
    waits: bool = Field(
        default=False,
        exclude_if=lambda value: not value,
        description="The service watches the bucket, and lets a log wait for its predictions: fail "
        "with `awaits` while there are none.",
    )


class MineLease(BaseModel):
    """The right, until it expires, to mine one shard, or to score its scenes again."""

    model_config = _STRICT

    kind: Literal["mine"] = "mine"
    lease_id: Name
    expires_s: Seconds
    recording: Recording
    shard: Shard
    rescore: RescoredShard | None = Field(
        default=None,
        description="Compute the scores of these scenes again from their overlays; if one cannot "
        "be, fail with `not_rescored`. Absent: mine the log.",
    )


class NothingToDo(BaseModel):
    """Reply that grants no lease now."""

    model_config = _STRICT

    kind: Literal["nothing"] = "nothing"
    retry_after_s: Seconds = 1.0
    problem: Text = Field(
        default="",
        exclude_if=lambda value: not value,
        description="Why this worker gets no work; empty: there is none.",
    )


class ClaimReply(BaseModel):
    """Reply to a claim: a lease, or none."""

    model_config = _STRICT

    grant: Annotated[PlanLease | MineLease | NothingToDo, Field(discriminator="kind")]


class RenewRequest(BaseModel):
    """Request of a worker to extend its lease."""

    model_config = _STRICT

    worker_id: Name
    lease_id: Name


class MiningStats(BaseModel):
    """Duration and amount of mining one shard; never part of a scored record."""

    model_config = _STRICT

    frames: Tally = Field(default=0, description="Frames scored, warm-up excluded.")
    points: Tally = 0
    bytes_read: Tally = 0
    bytes_needed: Tally = 0
    range_reads: Tally = 0
    pictures: Tally = Field(default=0, description="Camera pictures kept with the scenes.")
    picture_bytes: Tally = 0
    stage_s: dict[Name, Seconds] = Field(default_factory=dict, max_length=256)
    peak_memory_bytes: Tally = 0


class CommitRequest(BaseModel):
    """A finished lease: a plan, or the manifest of a mined shard.

    `records` contains, as text, the records that an earlier answer listed as missing.
    """

    model_config = _STRICT

    worker_id: Name
    lease_id: Name
    plan: LogPlan | None = None
    manifest: tuple[ManifestEntry, ...] = Field(
        fail_fast=True, default=(), max_length=MAX_SCENES_OF_A_SHARD
    )
    records: tuple[RecordText, ...] = Field(
        fail_fast=True, default=(), max_length=MAX_SCENES_OF_A_SHARD
    )
    damage: tuple[Damage, ...] = Field(fail_fast=True, default=(), max_length=MAX_CHUNKS)
    stats: MiningStats = Field(default_factory=MiningStats)


class FailRequest(BaseModel):
    """Return of a lease by a worker, with its error."""

    model_config = _STRICT

    worker_id: Name
    lease_id: Name
    error: Text
    permanent: bool = Field(description="Trying again would fail the same way.")
    replaced: bool = Field(
        default=False, description="An object changed under the reader: plan the log again."
    )
    growing: bool = Field(
        default=False,
        description="Not settled and without a valid footer: wait until it has not changed for a "
        "while. No attempt is used up.",
    )
    awaits: bool = Field(
        default=False,
        exclude_if=lambda value: not value,
        description="The predictions next to the log have not come: look again after a part of its "
        "age. No attempt is used up.",
    )
    given_back: bool = Field(
        default=False,
        description="The worker was stopped, or a store as a whole fails: this work is not at "
        "fault, and no attempt is used up.",
    )
    not_rescored: bool = Field(
        default=False,
        description="An overlay is gone, or has no inputs of the score: mine the shard. No attempt "
        "is used up.",
    )


class Answer(BaseModel):
    """Answer of the service to renew, commit and fail."""

    model_config = _STRICT

    ok: bool
    missing: tuple[SceneId, ...] = Field(
        default=(), max_length=MAX_SCENES_OF_A_SHARD, description="Scene ids to send again."
    )
    problem: Text = ""
