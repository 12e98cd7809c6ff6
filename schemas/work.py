"""What service and workers say to each other: leases, plans, commits.

All of it is asked by the worker and answered by the service (`schemas.keys.control`), one message
each way. An answer to `commit` comes after the database transaction, never before.
"""

import hashlib
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from schemas.camera import CameraCalibration
from schemas.wire import canonical_json

_STRICT = ConfigDict(frozen=True, extra="forbid")


class Part(BaseModel):
    """One object of a recording, identified by key, size and etag."""

    model_config = _STRICT

    key: str = Field(min_length=1)
    size: int = Field(ge=0)
    etag: str


class Recording(BaseModel):
    """One log as it lies in the bucket: one MCAP file, or the parts of a split recording."""

    model_config = _STRICT

    log_id: str = Field(min_length=1, description="Key without extension and split number.")
    parts: tuple[Part, ...] = Field(min_length=1, description="In the order of their numbers.")

    @property
    def revision(self) -> str:
        """Digest of keys, sizes and etags: part of the ledger's key, never of a scored record."""
        return hashlib.sha256(
            canonical_json([part.model_dump(mode="json") for part in self.parts])
        ).hexdigest()[:16]


class ChunkRef(BaseModel):
    """Where to read messages: an MCAP Chunk record, or a run of records outside any chunk."""

    model_config = _STRICT

    kind: Literal["chunk", "records"] = "chunk"
    part: int = Field(ge=0, description="Index into the recording's parts.")
    offset: int = Field(ge=0, description="First byte of the record(s) in that part.")
    length: int = Field(gt=0, description="Bytes to read.")
    start_ns: int = Field(ge=0, description="Earliest log time inside.")
    end_ns: int = Field(ge=0, description="Latest log time inside.")


class Channel(BaseModel):
    """An MCAP channel and its schema, enough to decode its messages without the summary."""

    model_config = _STRICT

    topic: str
    message_encoding: str
    schema_name: str
    schema_encoding: str
    schema_base64: str = Field(description="Bytes of the schema record, base64.")
    ids: tuple[tuple[int, int], ...] = Field(description="(part, channel id) pairs it goes by.")


class RecordedSource(BaseModel):
    """Where the labels of the model that ran on the car lie."""

    model_config = _STRICT

    channel: Channel | None = Field(
        default=None, description="A topic of its own; None: fields of the cloud itself."
    )
    classes_json: str = Field(description="MCAP metadata `counterpoint.classes`, as one JSON map.")


class Shard(BaseModel):
    """A time window of one lidar of one log, with the chunks it needs: what a worker leases.

    Messages are judged by frame stamp: those in [start_ns, end_ns) are scored, those from
    `warmup_start_ns` on are only seen, those until `lookahead_end_ns` only decide whether a short
    last piece belongs to this shard, and what streams that look ahead say of the last frames.
    """

    model_config = _STRICT

    log_id: str
    index: int = Field(ge=0)
    lidar: Channel
    recorded: RecordedSource | None = None
    motion: Channel | None = Field(
        default=None, description="What the car recorded of its own motion, if it did."
    )
    camera: CameraCalibration | None = None
    anchor_ns: int = Field(ge=0, description="First frame of the log: origin of the grid.")
    warmup_start_ns: int = Field(ge=0)
    start_ns: int = Field(ge=0)
    end_ns: int = Field(ge=0, description="First instant after the window.")
    lookahead_end_ns: int = Field(ge=0, description="Equal to end_ns where none is needed.")
    before_lookahead_end_ns: int = Field(
        default=0, ge=0, description="`lookahead_end_ns` of the shard before; 0 where none is."
    )
    scene_s: float = Field(default=2.0, gt=0, description="Length of a scene's cell.")
    first_of_log: bool = False
    last_of_log: bool = False
    chunks: tuple[ChunkRef, ...]
    needed_bytes: int = Field(ge=0, description="Stored bytes of chunks with scored messages.")
    by_log_time: bool = Field(
        default=False, description="Frame time is the log time: the sensor's clock jumped."
    )
    intensity_scale: float = Field(default=1.0, gt=0, description="Recorded value that means 1.")
    vehicle: str = "unknown"
    date: str = "unknown"
    software_version: str = "unknown"

    @property
    def lidar_name(self) -> str:
        """The lidar topic as it stands in scene ids and shard names."""
        return self.lidar.topic.strip("/").replace(".", "%2E").replace("/", ".")

    @property
    def name(self) -> str:
        """Unique within the log, for one grid."""
        return f"{self.lidar_name}-{self.index:05d}"


class Damage(BaseModel):
    """A stretch of a log that cannot be read: it costs itself, not the log."""

    model_config = _STRICT

    key: str = Field(default="", description="Object it lies in.")
    offset: int = Field(ge=0)
    bytes: int = Field(ge=0)
    what: str


class LogPlan(BaseModel):
    """What planning found in a recording: its shards, and what cannot be read or used."""

    model_config = _STRICT

    log_id: str
    vehicle: str = "unknown"
    date: str = "unknown"
    software_version: str = "unknown"
    lidar_topics: tuple[str, ...] = ()
    shards: tuple[Shard, ...] = ()
    damage: tuple[Damage, ...] = ()
    truncated_parts: int = Field(
        default=0, ge=0, description="Objects that were never closed: used as far as they go."
    )
    refused: str = Field(default="", description="Why the log cannot be mined; empty when it can.")
    range_reads: int = Field(default=0, ge=0)
    bytes_read: int = Field(default=0, ge=0)


class ClaimRequest(BaseModel):
    """A worker asks for something to do."""

    model_config = _STRICT

    worker_id: str = Field(min_length=1)
    pipeline_version: str = Field(min_length=1)


class PlanLease(BaseModel):
    """The right, until it expires, to plan one recording."""

    model_config = _STRICT

    kind: Literal["plan"] = "plan"
    lease_id: str
    expires_s: float
    recording: Recording
    settled: bool = Field(
        default=True,
        description="False: listed a moment ago, it may still grow; plan it only if every part "
        "ends in a valid footer, else fail with `growing`.",
    )


class MineLease(BaseModel):
    """The right, until it expires, to mine one shard."""

    model_config = _STRICT

    kind: Literal["mine"] = "mine"
    lease_id: str
    expires_s: float
    recording: Recording
    shard: Shard


class NothingToDo(BaseModel):
    """No lease now."""

    model_config = _STRICT

    kind: Literal["nothing"] = "nothing"
    retry_after_s: float = 1.0


class ClaimReply(BaseModel):
    """What the service grants."""

    model_config = _STRICT

    grant: Annotated[PlanLease | MineLease | NothingToDo, Field(discriminator="kind")]


class RenewRequest(BaseModel):
    """A worker is still at it."""

    model_config = _STRICT

    worker_id: str
    lease_id: str


class ManifestEntry(BaseModel):
    """One record that a worker has published."""

    model_config = _STRICT

    scene_id: str
    sha256: str


class MiningStats(BaseModel):
    """What mining a shard took; never part of a scored record."""

    model_config = _STRICT

    frames: int = Field(default=0, ge=0, description="Frames scored, warm-up excluded.")
    points: int = Field(default=0, ge=0)
    bytes_read: int = Field(default=0, ge=0)
    bytes_needed: int = Field(default=0, ge=0)
    range_reads: int = Field(default=0, ge=0)
    stage_s: dict[str, float] = Field(default_factory=dict)
    peak_memory_bytes: int = Field(default=0, ge=0)


class CommitRequest(BaseModel):
    """A finished lease: a plan, or the manifest of a mined shard.

    `records` carries again, as text, what an earlier answer named missing.
    """

    model_config = _STRICT

    worker_id: str
    lease_id: str
    plan: LogPlan | None = None
    manifest: tuple[ManifestEntry, ...] = ()
    records: tuple[str, ...] = ()
    damage: tuple[Damage, ...] = ()
    stats: MiningStats = Field(default_factory=MiningStats)


class FailRequest(BaseModel):
    """A worker gives a lease back with its error."""

    model_config = _STRICT

    worker_id: str
    lease_id: str
    error: str
    permanent: bool = Field(description="Trying again would fail the same way.")
    replaced: bool = Field(
        default=False, description="An object changed under the reader: plan the log anew."
    )
    growing: bool = Field(
        default=False,
        description="Not settled and without a valid footer: wait until it has not changed for a "
        "while. No attempt is used up.",
    )
    given_back: bool = Field(
        default=False,
        description="The worker was told to stop, or a store as a whole is in trouble: no fault of "
        "this work, and no attempt used up.",
    )


class Answer(BaseModel):
    """What the service says to renew, commit and fail."""

    model_config = _STRICT

    ok: bool
    missing: tuple[str, ...] = Field(default=(), description="Scene ids to send again.")
    problem: str = ""
