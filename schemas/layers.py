"""Layers of a pipeline version, and the scenes that are scored again where the score changed."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import MAX_SCENES_OF_A_SHARD, Digest, LogId, Name, SceneId

_STRICT = ConfigDict(frozen=True, extra="forbid")


class ManifestEntry(BaseModel):
    """One record that a worker has published."""

    model_config = _STRICT

    scene_id: SceneId
    sha256: Digest


class Layers(BaseModel):
    """Digests of the layers of a pipeline version, each of which depends on those before it."""

    model_config = _STRICT

    labels: Name = Field(description="Reading, odometry, streams and witness.")
    contradictions: Name = Field(description="Agreement, instances, tracks and features.")
    score: Name = Field(description="Attribution, ranking of tracks, and score.")


class RescoredShard(BaseModel):
    """Scenes of a shard that an earlier version mined, or another log with the same bytes."""

    model_config = _STRICT

    pipeline_version: Name = Field(description="Version that mined them.")
    scenes: tuple[ManifestEntry, ...] = Field(
        fail_fast=True, default=(), max_length=MAX_SCENES_OF_A_SHARD
    )
    log_id: LogId | Literal[""] = Field(
        default="",
        exclude_if=lambda value: not value,
        description="Log of these scenes, of the same bytes; empty: the log of the lease.",
    )
