"""Published JSON message of boxes: the answer of a model under test, for recorders of any language.

A channel of an MCAP log with message encoding `json` and schema name `counterpoint.boxes.v1` has
one such message per answer. The schema file is `boxes.v1.schema.json` in this folder.
"""

from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import Finite, Said, StampNs

SCHEMA_NAME: Final = "counterpoint.boxes.v1"

MAX_BOXES: Final = 1_024
"""Boxes of one message; detectors on cars give 20 to 500."""

Metres = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Vector = tuple[Metres, Metres, Metres]

_PUBLISHED = ConfigDict(frozen=True, extra="ignore")
"""Fields that are not known are ignored, so that a message may carry more."""


class PredictedBox(BaseModel):
    """One box: where an object is, and what the model knows of it."""

    model_config = _PUBLISHED

    centre_m: Vector = Field(description="x, y, z of the centre in the frame, metres.")
    size_m: Vector = Field(description="Length, width and height, metres.")
    yaw_rad: Finite = Field(
        default=0.0,
        description="Heading about z of the frame, radians; where `quaternion_xyzw` is absent.",
    )
    quaternion_xyzw: tuple[Finite, Finite, Finite, Finite] | None = Field(
        default=None, description="Rotation of the box in the frame; x is along the length."
    )
    velocity_m_per_s: Vector | None = Field(
        default=None,
        description="Velocity over the ground, along the axes of the frame; absent: not known.",
    )
    class_name: Said = Field(default="", description="Class by name; empty: none.")
    score: Annotated[float, Field(ge=0, le=1)] | None = Field(
        default=None, description="Confidence of the model, 0 to 1; absent: not known."
    )
    track_id: Said = Field(
        default="", description="Identity of the object over time; empty: the model does not track."
    )


class PredictedBoxes(BaseModel):
    """One answer of the model: all boxes of one instant."""

    model_config = _PUBLISHED

    stamp_ns: StampNs = Field(
        description="Time of the boxes, nanoseconds since the Unix epoch; that of the cloud where "
        "they were found in one."
    )
    frame_id: Said = Field(
        default="", description="Coordinate frame, by its name in tf; empty: the lidar's own."
    )
    boxes: tuple[PredictedBox, ...] = Field(
        fail_fast=True, max_length=MAX_BOXES, description="Empty: the model found nothing."
    )
