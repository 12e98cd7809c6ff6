"""What `counterpoint status` says: how far the logs are, what is damaged, what is parked."""

from pydantic import BaseModel, ConfigDict, Field

from schemas.work import Damage

_STRICT = ConfigDict(frozen=True, extra="forbid")


class LogStatus(BaseModel):
    """One current recording and how far it is under one pipeline version."""

    model_config = _STRICT

    log_id: str
    state: str = Field(
        description="waiting, settling (it still grows, or is cut short: planned when it has not "
        "changed for a while), planning, mining, done, refused, parked, or stale (its object "
        "changed under a reader; the next listing decides)."
    )
    vehicle: str = "unknown"
    date: str = "unknown"
    software_version: str = "unknown"
    lidar_topics: tuple[str, ...] = ()
    problem: str = Field(default="", description="Why it was refused or parked.")
    truncated_parts: int = Field(
        default=0, description="Objects that were never closed: used as far as they go."
    )
    damage: tuple[Damage, ...] = ()
    shards: dict[str, int] = Field(default_factory=dict, description="Shards by state.")
    frames: int = Field(default=0, description="Frames scored.")
    plan_range_reads: int = 0
    plan_bytes_read: int = 0
    mine_range_reads: int = 0
    mine_bytes_read: int = 0
    bytes_needed: int = 0
    peak_memory_bytes: int = 0


class ParkedWork(BaseModel):
    """A plan or shard that is not tried again, unless a person asks for it."""

    model_config = _STRICT

    log_id: str
    shard: str = Field(description="Name of the shard; empty: the planning of the log.")
    attempts: int
    error: str


class PointTotals(BaseModel):
    """Points of all current scenes by agreement."""

    model_config = _STRICT

    both_static: int = 0
    both_dynamic: int = 0
    only_semantic_dynamic: int = 0
    only_predictive_dynamic: int = 0
    not_compared: int = 0


class Judged(BaseModel):
    """Two streams whose labels were compared, and how many current scenes tell of that."""

    model_config = _STRICT

    supervised: str = Field(description="`name@version` of the stream that was judged.")
    selfsupervised: str = Field(description="`name@version` of the stream beside it.")
    scenes: int = Field(ge=1)


class Status(BaseModel):
    """The ledger at one moment, under one pipeline version."""

    model_config = _STRICT

    pipeline_version: str = Field(description="Empty: no worker has asked for work yet.")
    logs: tuple[LogStatus, ...] = ()
    logs_by_state: dict[str, int] = Field(default_factory=dict)
    shards_by_state: dict[str, int] = Field(default_factory=dict)
    parked: tuple[ParkedWork, ...] = ()
    retried: tuple[ParkedWork, ...] = Field(
        default=(),
        description="Was parked with this error, is tried again, and has not failed since.",
    )
    scenes: int = Field(default=0, description="Current scenes, of any pipeline version.")
    frames: int = Field(default=0, description="Frames scored under this pipeline version.")
    frames_per_s: float = Field(default=0.0, description="Over the commits of the last minute.")
    bytes_read: int = Field(default=0, description="Bytes that mining read; planning apart.")
    bytes_needed: int = Field(default=0, description="Stored bytes of chunks with scored frames.")
    plan_bytes_read: int = 0
    peak_memory_bytes: int = Field(default=0, description="Most memory that any worker held.")
    points: PointTotals = Field(default_factory=PointTotals)
    judged: tuple[Judged, ...] = Field(
        default=(), description="Streams that current scenes compare; of most scenes first."
    )
    last_seq: int = Field(default=0, description="Number of the newest scene event.")
    published_seq: int = Field(default=0, description="Number up to which events are published.")
