"""Header of an overlay: what the scene is, and where each block of the file lies."""

import struct
from collections.abc import Callable, Iterator
from typing import Annotated, Final, Literal
from zlib import crc32

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import MAX_INTEGER, Finite, Name, SceneId, Topic
from schemas.canonical import canonical_json
from schemas.mining import MAX_JOINED
from schemas.overlay_picture import MAX_COEFFICIENTS, MAX_MODEL, MAX_PICTURES, MAX_SIDE_PX
from schemas.task import MAX_CLASSES
from schemas.transport.array_pack import MAX_UNPACKED_BYTES

OVERLAY_MAGIC: Final = b"CPOVL2\n\0"
"""First bytes of an overlay; the digit is the version."""

MAX_HEADER_BYTES: Final = 64 * 1024 * 1024
MAX_FRAMES: Final = 100_000
MAX_INSTANCES: Final = 2_000_000

BEGIN: Final = struct.Struct("<8sII")
"""Magic, length of the header and its CRC-32."""

Offset = Annotated[int, Field(ge=0, le=MAX_UNPACKED_BYTES)]
Block = tuple[Offset, Offset]
"""Offset from the first byte of the file, and length, bytes."""

Crc = Annotated[int, Field(ge=0, le=2**32 - 1)]
"""CRC-32 of a block, as it lies in the file."""

Stamp = Annotated[str, Field(pattern=r"^-?[0-9]{1,19}$")]
"""Nanoseconds since the Unix epoch as a decimal text: a number of JavaScript ends at 2**53."""

Transform16 = Annotated[tuple[Finite, ...], Field(min_length=16, max_length=16)]
Box = Annotated[tuple[Finite, ...], Field(min_length=7, max_length=7)]
Index = Annotated[int, Field(ge=-1, le=MAX_INSTANCES)]
Code = Annotated[int, Field(ge=0, le=MAX_CLASSES**2)]

_STRICT = ConfigDict(frozen=True, extra="ignore")


class FrameEntry(BaseModel):
    """One frame of a scene."""

    model_config = _STRICT

    stamp_ns: Stamp
    points: Offset
    view: Block = Field(description="Coordinates, labels, classes, ground and instances.")
    view_crc32: Crc
    rest: Block = Field(description="Confidences of both streams.")
    rest_crc32: Crc
    odom_from_sensor: Transform16 = Field(description="Row by row.")


class LidarEntry(BaseModel):
    """A further lidar of a scene; its points follow those of the lidars before it in a frame."""

    model_config = _STRICT

    topic: Topic
    points: list[Offset] = Field(max_length=MAX_FRAMES, description="In each frame.")
    stamps_ns: list[Stamp] = Field(max_length=MAX_FRAMES, description="Of each cloud; 0: none.")
    main_from_lidar: list[Transform16] = Field(
        max_length=MAX_FRAMES, description="Its space to the sensor space of each frame."
    )


class InstanceColumns(BaseModel):
    """The instances of a scene, a column for each property."""

    model_config = _STRICT

    frame: list[Index] = Field(max_length=MAX_INSTANCES)
    kind: list[Code] = Field(max_length=MAX_INSTANCES, description="Code of the outcome.")
    track: list[Index] = Field(max_length=MAX_INSTANCES)
    boxes: list[Box] = Field(
        max_length=MAX_INSTANCES,
        description="x, y, z, length, width, height in metres, yaw in radians, sensor space.",
    )


class PictureCalibration(BaseModel):
    """Projection of the points of a frame into a picture."""

    model_config = _STRICT

    pixel_from_camera: tuple[Finite, ...] = Field(min_length=12, max_length=12)
    camera_from_lidar: Transform16
    width: int = Field(ge=1, le=MAX_SIDE_PX)
    height: int = Field(ge=1, le=MAX_SIDE_PX)
    distortion_model: str = Field(default="", max_length=MAX_MODEL)
    distortion: tuple[Finite, ...] = Field(default=(), max_length=MAX_COEFFICIENTS)


class PictureEntry(BaseModel):
    """One camera picture of a scene."""

    model_config = _STRICT

    topic: Topic
    frame: int = Field(ge=0, le=MAX_FRAMES)
    stamp_ns: Stamp
    width: int = Field(ge=1, le=MAX_SIDE_PX)
    height: int = Field(ge=1, le=MAX_SIDE_PX)
    block: Block
    crc32: Crc
    media_type: Literal["image/jpeg", "image/png"]
    calibration: PictureCalibration
    tracks: tuple[Annotated[int, Field(ge=0, le=MAX_INTEGER)], ...] = Field(
        max_length=MAX_INSTANCES, description="Tracks that it sees."
    )


class OverlayHeader(BaseModel):
    """Header of an overlay, version 2."""

    model_config = _STRICT

    scene_id: SceneId
    task: Name
    class_names: list[Annotated[str, Field(max_length=MAX_SIDE_PX)]] = Field(max_length=MAX_SIDE_PX)
    frames: list[FrameEntry] = Field(min_length=1, max_length=MAX_FRAMES)
    instances: InstanceColumns
    lidars: list[LidarEntry] = Field(
        default_factory=list, max_length=MAX_JOINED, description="Absent where one was mined."
    )
    pictures: list[PictureEntry] = Field(max_length=MAX_PICTURES)
    inputs: Block = Field(description="Inputs of the score; of length 0 without any.")
    inputs_crc32: Crc

    def blocks(self) -> Iterator[Block]:
        """Yield every block of the file."""
        for frame in self.frames:
            yield frame.view
            yield frame.rest
        for picture in self.pictures:
            yield picture.block
        yield self.inputs

    @property
    def points(self) -> int:
        """Points of all frames."""
        return sum(frame.points for frame in self.frames)


def encoded_header(header_at: Callable[[int], dict[str, object]]) -> bytes:
    """Encode a header with all that is before the first block.

    Args:
        header_at: Returns the header for the offset at which the blocks begin. The offset is a
            number in it, so that its length depends on it: it is enlarged until it fits.
    """
    begin = 0
    while True:
        header = canonical_json(header_at(begin))
        if len(header) > MAX_HEADER_BYTES:
            raise ValueError(f"overlay header of {len(header)} bytes exceeds {MAX_HEADER_BYTES}")
        if begin == BEGIN.size + len(header):
            return BEGIN.pack(OVERLAY_MAGIC, len(header), crc32(header)) + header
        begin = BEGIN.size + len(header)
