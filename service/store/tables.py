"""Table definitions for queries; `migrations` creates them, and a test compares the two."""

from typing import Any, Final

from sqlalchemy import BigInteger, Boolean, Column, Double, LargeBinary, MetaData, Table, Text

METADATA: Final = MetaData()


def _text(name: str, *, key: bool = False) -> Column[Any]:
    return Column(name, Text, primary_key=key, nullable=False)


def _number(name: str, *, key: bool = False, nullable: bool = False) -> Column[Any]:
    return Column(name, BigInteger, primary_key=key, nullable=nullable, autoincrement=False)


def _real(name: str, *, nullable: bool = False) -> Column[Any]:
    return Column(name, Double, nullable=nullable)


def _may_be_null(name: str) -> Column[Any]:
    return Column(name, Text, nullable=True)


def _flag(name: str) -> Column[Any]:
    return Column(name, Boolean, nullable=False)


SCHEMA_VERSIONS: Final = Table("schema_version", METADATA, _number("version", key=True))

COUNTERS: Final = Table("counters", METADATA, _text("name", key=True), _number("value"))

SERVED_BUCKET: Final = Table("served_bucket", METADATA, _text("url"))

WRITE_PROOF: Final = Table(
    "write_proof", METADATA, _number("writes"), _text("incarnation"), _number("term")
)

SERVICE_LEASE: Final = Table("service_lease", METADATA, _number("beats"), _real("lease_s"))

PIPELINES: Final = Table(
    "pipelines",
    METADATA,
    _text("pipeline_version", key=True),
    _number("ordinal"),
    _text("labels"),
    _text("contradictions"),
    _text("score"),
)

RECORDINGS: Final = Table(
    "recordings",
    METADATA,
    _text("log_id", key=True),
    _text("revision", key=True),
    _text("recording"),
    _flag("is_current"),
    _real("listed_s"),
    _text("content"),
    _text("same_as"),
)

PLANS: Final = Table(
    "plans",
    METADATA,
    _text("log_id", key=True),
    _text("revision", key=True),
    _text("pipeline_version", key=True),
    _text("state"),
    _number("attempts"),
    _text("error"),
    _real("ready_at_s"),
    _text("lease_id"),
    _text("vehicle"),
    _text("date"),
    _text("software_version"),
    _text("lidar_topics"),
    _text("digest"),
    _number("range_reads"),
    _number("bytes_read"),
    _number("truncated_parts"),
    _number("turn"),
    _text("inherited_from"),
)

SHARDS: Final = Table(
    "shards",
    METADATA,
    _text("log_id", key=True),
    _text("revision", key=True),
    _text("pipeline_version", key=True),
    _text("name", key=True),
    _text("lidar_topic"),
    _number("shard_index"),
    _number("covers_from_ns"),
    _number("covers_to_ns"),
    _text("shard"),
    _text("state"),
    _number("attempts"),
    _text("error"),
    _real("ready_at_s"),
    _text("lease_id"),
    _text("digest"),
    _real("committed_s"),
    _number("frames"),
    _number("points"),
    _number("bytes_read"),
    _number("bytes_needed"),
    _number("range_reads"),
    _number("peak_memory_bytes"),
    _text("stage_s"),
    _text("adopted_from"),
    _number("turn"),
    _text("rescored_from"),
    _real("mined_s"),
    _text("taken_from_log"),
    _text("taken_from_revision"),
)

LEASES: Final = Table(
    "leases",
    METADATA,
    _text("lease_id", key=True),
    _text("worker_id"),
    _text("log_id"),
    _text("revision"),
    _text("pipeline_version"),
    _text("shard"),
    _real("expires_s"),
    _flag("is_held"),
    _text("ended_by"),
    _number("lane"),
)

DAMAGE: Final = Table(
    "damage",
    METADATA,
    _text("log_id", key=True),
    _text("revision", key=True),
    _text("pipeline_version", key=True),
    _text("shard", key=True),
    _number("position", key=True),
    _text("object_key"),
    _number("byte_offset"),
    _number("byte_count"),
    _text("what"),
)
DAMAGED: Final = DAMAGE.c.byte_count > 0
"""True for a stretch that cannot be read; the others are notices, which cost no byte."""

SCENES: Final = Table(
    "scenes",
    METADATA,
    _text("log_id", key=True),
    _text("revision", key=True),
    _text("pipeline_version", key=True),
    _text("scene_id", key=True),
    _text("shard"),
    _number("seq", nullable=True),
    _number("withdrawn_seq", nullable=True),
    _flag("is_current"),
    _text("withdrawn_by"),
    _text("lidar_topic"),
    _text("vehicle"),
    _text("date"),
    _text("software_version"),
    _number("start_ns"),
    _number("end_ns"),
    _number("frames"),
    _text("state"),
    _real("score"),
    _text("reasons"),
    _number("both_static"),
    _number("both_dynamic"),
    _number("only_semantic_dynamic"),
    _number("only_predictive_dynamic"),
    _number("not_compared"),
    _text("sha256"),
    Column("record", LargeBinary, nullable=False),
)

RETIRED_OVERLAYS: Final = Table(
    "retired_overlays",
    METADATA,
    _text("log_id", key=True),
    _text("scene_id", key=True),
    _text("pipeline_version", key=True),
    _text("sha256", key=True),
    _real("since_s"),
    _flag("is_deleted"),
)

SELECTIONS: Final = Table(
    "selections",
    METADATA,
    _text("name", key=True),
    _number("ordinal"),
    _number("budget"),
    _real("created_s"),
    _text("strategy"),
)

SELECTION_SCENES: Final = Table(
    "selection_scenes",
    METADATA,
    _text("name", key=True),
    _number("position", key=True),
    _text("scene"),
)

SKIPPED_ENTRIES: Final = Table(
    "skipped_entries",
    METADATA,
    _number("position", key=True),
    _text("name"),
    _text("why"),
    _number("others"),
)

VERDICTS: Final = Table(
    "verdicts",
    METADATA,
    _number("ordinal", key=True),
    _text("key"),
    _text("scene_id"),
    _text("sha256"),
    _number("track_id", nullable=True),
    _text("reviewer"),
    _text("verdict"),
    _text("cause"),
    _text("note"),
    _may_be_null("duplicate_of"),
    _real("judged_s"),
    _real("took_s", nullable=True),
    _flag("is_current"),
    _text("vehicle"),
    _text("software_version"),
    _text("kinds"),
)

AUDIT: Final = Table(
    "audit",
    METADATA,
    _number("ordinal", key=True),
    _real("at_s"),
    _text("name"),
    _text("says"),
    _text("via"),
    _text("what"),
    _text("detail"),
    _text("digest"),
)

LISTING_SOURCES: Final = Table(
    "listing_sources",
    METADATA,
    _number("source", key=True),
    _text("digest"),
    _text("log_id"),
    _text("lidar_topic"),
    _text("vehicle"),
    _text("software_version"),
    _text("mode"),
)

LISTING_FINDINGS: Final = Table(
    "listing_findings",
    METADATA,
    _number("finding", key=True),
    _text("digest"),
    _text("kinds"),
    _text("class_names"),
    _text("wrongs"),
)

LISTED_SCENES: Final = Table(
    "listed_scenes",
    METADATA,
    _number("seq", key=True),
    _real("place"),
    _number("start_ns"),
    _number("source"),
    _number("finding"),
    _number("judged"),
    _number("compared"),
    _number("contradicting"),
    _number("near_ranges"),
    _number("far_ranges"),
)

LISTING_THINGS: Final = Table(
    "listing_things",
    METADATA,
    _number("thing", key=True),
    _text("digest"),
    _text("kind"),
    _text("class_name"),
    _text("wrong"),
)

LISTED_TRACKS: Final = Table(
    "listed_tracks",
    METADATA,
    _number("thing", key=True),
    _number("seq", key=True),
    _number("near_ranges"),
    _number("far_ranges"),
)

LISTED_WORDS: Final = Table("listed_words", METADATA, _number("seq", key=True), _text("words"))

WEBHOOK_CURSORS: Final = Table(
    "webhook_cursors",
    METADATA,
    _text("receiver", key=True),
    _text("source", key=True),
    _number("value"),
)

NOTICES: Final = Table(
    "notices",
    METADATA,
    _number("ordinal", key=True),
    _text("kind"),
    _text("name"),
    _text("body"),
    _real("noted_s"),
)
