"""Status of a ledger: progress of the logs, damaged stretches, parked work."""

from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import MAX_LISTED, Count, Finite, Kept, Positive
from schemas.work import Damage

_STRICT = ConfigDict(frozen=True, extra="forbid")

MAX_NAMED: Final = 10
"""Skipped entries that are kept by name; further ones are only counted."""


class LogStatus(BaseModel):
    """One current recording and its progress under one pipeline version."""

    model_config = _STRICT

    log_id: Kept
    state: Kept = Field(
        description="waiting, settling, planning, mining, done, refused, parked, stale, kept or "
        "same. A settling log still grows or is truncated, and is planned once it is unchanged "
        "for a while. The object of a stale log changed under a reader; the next listing decides. "
        "A kept log was mined by an earlier pipeline version, and `remine` leaves it out. A log "
        "is the same where another one has the same bytes, and is mined for both."
    )
    vehicle: Kept = "unknown"
    date: Kept = "unknown"
    software_version: Kept = "unknown"
    lidar_topics: tuple[Kept, ...] = Field(fail_fast=True, default=(), max_length=MAX_LISTED)
    problem: Kept = Field(
        default="", description="Cause of a refused or parked log; or which log has its bytes."
    )
    truncated_parts: Count = Field(
        default=0, description="Objects that were never closed, and are used up to their end."
    )
    damage: tuple[Damage, ...] = Field(fail_fast=True, default=(), max_length=MAX_LISTED)
    shards: dict[Kept, Count] = Field(
        default_factory=dict, max_length=MAX_LISTED, description="Shards by state."
    )
    frames: Count = Field(default=0, description="Frames scored.")
    plan_range_reads: Count = 0
    plan_bytes_read: Count = 0
    mine_range_reads: Count = 0
    mine_bytes_read: Count = 0
    bytes_needed: Count = 0
    peak_memory_bytes: Count = 0


class ParkedWork(BaseModel):
    """A plan or shard that is retried only on request."""

    model_config = _STRICT

    log_id: Kept
    shard: Kept = Field(description="Name of the shard; empty: the plan of the log.")
    attempts: Count
    error: Kept


class PointTotals(BaseModel):
    """Points of all current scenes by agreement."""

    model_config = _STRICT

    both_static: Count = 0
    both_dynamic: Count = 0
    only_semantic_dynamic: Count = 0
    only_predictive_dynamic: Count = 0
    not_compared: Count = 0


class Judged(BaseModel):
    """Two compared streams, and the number of current scenes that compare them."""

    model_config = _STRICT

    supervised: Kept = Field(description="`name@version` of the supervised stream.")
    selfsupervised: Kept = Field(description="`name@version` of the self-supervised stream.")
    scenes: Positive


class SkippedEntry(BaseModel):
    """An entry of the bucket that is no log."""

    model_config = _STRICT

    name: Kept
    why: Kept = Field(description="The end of a sentence that begins with the name.")


class SkippedEntries(BaseModel):
    """Entries of the bucket that the last listing skipped; those that a pattern leaves out are not.

    What cannot be listed comes first, then objects of other types.
    """

    model_config = _STRICT

    count: Count = 0
    named: tuple[SkippedEntry, ...] = Field(
        default=(), max_length=MAX_NAMED, description="The first of them."
    )


class Status(BaseModel):
    """Status of the ledger at one moment, under one pipeline version."""

    model_config = _STRICT

    pipeline_version: Kept = Field(
        description="Newest pipeline version; empty: no worker has claimed work yet."
    )
    logs: tuple[LogStatus, ...] = Field(fail_fast=True, default=(), max_length=MAX_LISTED)
    logs_by_state: dict[Kept, Count] = Field(default_factory=dict, max_length=MAX_LISTED)
    shards_by_state: dict[Kept, Count] = Field(default_factory=dict, max_length=MAX_LISTED)
    parked: tuple[ParkedWork, ...] = Field(fail_fast=True, default=(), max_length=MAX_LISTED)
    retried: tuple[ParkedWork, ...] = Field(
        fail_fast=True,
        default=(),
        max_length=MAX_LISTED,
        description="Retried work, with the error for which it was parked; it has not failed "
        "since.",
    )
    scenes: Count = Field(default=0, description="Current scenes, of any pipeline version.")
    frames: Count = Field(default=0, description="Frames scored under this pipeline version.")
    frames_per_s: Finite = Field(
        default=0.0, description="Frames per second over the commits of the last minute."
    )
    bytes_read: Count = Field(default=0, description="Bytes read by mining, without planning.")
    bytes_needed: Count = Field(default=0, description="Stored bytes of chunks with scored frames.")
    plan_bytes_read: Count = 0
    peak_memory_bytes: Count = Field(default=0, description="Largest memory of any worker, bytes.")
    points: PointTotals = Field(default_factory=PointTotals)
    skipped: SkippedEntries = Field(default_factory=SkippedEntries)
    judged: tuple[Judged, ...] = Field(
        fail_fast=True,
        default=(),
        max_length=MAX_LISTED,
        description="Streams that the current scenes compare; the most frequent pair first.",
    )
    last_seq: Count = Field(default=0, description="Number of the newest scene event.")
    published_seq: Count = Field(default=0, description="Number up to which events are published.")


def skipped_phrases(skipped: SkippedEntries, *, most: int = 3) -> list[str]:
    """Return a phrase on each of the first skipped entries, and one with the number of the others.

    Args:
        skipped: Entries of a bucket.
        most: Entries that are named at most.
    """
    named = skipped.named[:most]
    phrases = [f"{each.name} {each.why}" for each in named]
    if others := skipped.count - len(named):
        phrases.append(f"{others} more {'entry' if others == 1 else 'entries'}")
    return phrases
