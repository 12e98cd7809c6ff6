"""Channels of a log that a shard reads: lidars, the answer of the model on the car, its places."""

from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import MAX_PARTS, Blob, Count, Finite, Said, Topic
from schemas.recorded_source import PredictionFiles, StatedPose

_STRICT = ConfigDict(frozen=True, extra="forbid")

MAX_SPACE_TOPICS: Final = 16
"""Topics of transforms and poses that place the boxes of one log."""

MAX_STATIC_SPACES: Final = 256
"""Constant transforms of one log; a car has some dozens."""


class Channel(BaseModel):
    """An MCAP channel and its schema, enough to decode its messages without the summary."""

    model_config = _STRICT

    topic: Topic
    message_encoding: Said
    schema_name: Said
    schema_encoding: Said
    schema_base64: Blob = Field(description="Bytes of the schema record, base64.")
    ids: tuple[tuple[Count, Count], ...] = Field(
        fail_fast=True, max_length=MAX_PARTS, description="(part, channel id) pairs it goes by."
    )


class BoxSource(BaseModel):
    """Channel with boxes of the model that ran on the car, and what places them."""

    model_config = _STRICT

    channel: Channel | None = Field(default=None, description="None: boxes are in a file.")
    moving_spaces: tuple[Channel, ...] = Field(
        default=(), max_length=MAX_SPACE_TOPICS, description="Channels of transforms over time."
    )
    static_spaces: tuple[StatedPose, ...] = Field(
        default=(), max_length=MAX_STATIC_SPACES, description="Transforms that never change."
    )


class RecordedSource(BaseModel):
    """Channel, or files, with the labels of the model that ran on the car."""

    model_config = _STRICT

    channel: Channel | None = Field(
        default=None, description="A topic of its own; None: fields of the cloud itself."
    )
    classes_json: Blob = Field(description="MCAP metadata `counterpoint.classes`, as one JSON map.")
    boxes: BoxSource | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Boxes of a topic, in place of labels of points.",
    )
    files: PredictionFiles | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Files in place of what the log contains.",
    )


class FurtherLidar(BaseModel):
    """A lidar of the car whose clouds are joined to those of a shard's main lidar."""

    model_config = _STRICT

    channel: Channel
    recorded: RecordedSource | None = Field(
        default=None, description="Labels of its points; None: no answer for its points."
    )
    main_from_lidar: tuple[Finite, ...] = Field(
        min_length=16, max_length=16, description="(4, 4) its space to the main lidar's, by row."
    )
    period_ns: Count = Field(description="Usual step between frames of the main lidar.")
    intensity_scale: Finite = Field(default=1.0, gt=0, description="Recorded value that means 1.")
