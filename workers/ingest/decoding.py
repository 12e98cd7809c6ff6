"""Message decoding: fields from bytes, with the library of the message's encoding.

This module knows the encodings; `pointcloud`, `recorded_labels` and `camera` know the types.
"""

import json
import struct
from base64 import b64decode
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoders
from mcap_ros1._vendor.genpy.message import DeserializationError
from mcap_ros1.decoder import DecoderFactory as Ros1Decoders
from mcap_ros2.decoder import DecoderFactory as Ros2Decoders

from schemas.errors import PermanentError
from schemas.work import Channel
from workers.ingest.message_size import too_much_to_decode
from workers.ingest.messages import RawMessage
from workers.ingest.ros_definitions import ROS1_DEFINITIONS, ROS2_DEFINITIONS

Decoder = Callable[[bytes], Any]

NOT_DECODED: Final = (
    struct.error,
    DeserializationError,
    DecodeError,
    McapError,
    ValueError,  # Unicode, JSON and base64 errors too
    TypeError,
    LookupError,
    NotImplementedError,
    ArithmeticError,  # numbers in JSON beyond any float
    RecursionError,  # JSON nested without end
)
"""Errors of the libraries on bytes that do not match the schema."""


class MessageUnreadableError(PermanentError):
    """A message's bytes do not match its schema."""


def ros_type(channel: Channel) -> str:
    """Return the name of a ROS type that both generations share: `sensor_msgs/PointCloud2`."""
    return channel.schema_name.replace("/msg/", "/")


def can_decode(channel: Channel, *, ros: str, foxglove: str) -> bool:
    """Return True for a channel of this ROS type (CDR, ROS 1) or Foxglove type (protobuf, JSON)."""
    if channel.message_encoding in ("cdr", "ros1"):
        return ros_type(channel) == ros
    return channel.message_encoding in ("protobuf", "json") and channel.schema_name == foxglove


def decode_message(message: RawMessage) -> Any:
    """Decode a message into an object with its fields as attributes; JSON into a dict.

    Raises:
        MessageUnreadableError: If the encoding or type is not supported, or if the bytes do not
            match the schema.
    """
    channel = message.channel
    if problem := too_much_to_decode(channel, message.data):
        raise MessageUnreadableError(
            f"cannot decode message: {problem} ({channel.topic}, logged at {message.log_time_ns})"
        )
    try:
        decode = _decoder(
            channel.message_encoding,
            channel.schema_name,
            channel.schema_encoding,
            channel.schema_base64,
        )
        return decode(bytes(message.data))
    except NOT_DECODED as error:
        raise MessageUnreadableError(
            f"cannot decode message: {type(error).__name__}: {error} "
            f"({channel.topic}, {channel.schema_name} in {channel.message_encoding}, "
            f"logged at {message.log_time_ns})"
        ) from error


@lru_cache(maxsize=64)
def _decoder(encoding: str, name: str, schema_encoding: str, schema_base64: str) -> Decoder:
    """Build the decoder of one schema; the same text is compiled once per process."""
    if encoding == "json":
        return json.loads
    ros_name = name.replace("/msg/", "/")
    factory: Any
    if encoding == "cdr":
        factory, text = Ros2Decoders(), ROS2_DEFINITIONS[ros_name]
        schema = Schema(id=1, name=ros_name, encoding="ros2msg", data=text.encode())
    elif encoding == "ros1":
        factory, text = Ros1Decoders(), ROS1_DEFINITIONS[ros_name]
        schema = Schema(id=1, name=ros_name, encoding="ros1msg", data=text.encode())
    else:
        factory = ProtobufDecoders()
        data = b64decode(schema_base64)
        schema = Schema(id=1, name=name, encoding=schema_encoding, data=data)
    decoder: Decoder | None = factory.decoder_for(encoding, schema)
    if decoder is None:
        raise LookupError(f"no decoder for {encoding} with a schema in {schema_encoding}")
    return decoder
