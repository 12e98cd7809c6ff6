"""Message size: refuses, before decoding, a message that would take far more memory decoded."""

import struct
from typing import Final

from schemas.work import Channel
from workers.ingest.limits import MAX_CLOUD_BYTES, MAX_FIELDS, MAX_JSON_BYTES, MAX_OTHER_BYTES

LARGE_TYPES: Final = frozenset(
    {"PointCloud2", "CompressedImage", "PointCloud", "Image", "CompressedVideo"}
)
"""Types, without their package, whose messages are mostly one run of bytes."""

ROS_CLOUD: Final = "PointCloud2"


def too_much_to_decode(channel: Channel, data: bytes | memoryview) -> str:
    """Return why a message is not decoded; empty if it is.

    Args:
        channel: Its type and encoding.
        data: Its payload.
    """
    kind = channel.schema_name.rpartition("/")[2].rpartition(".")[2]
    most = MAX_CLOUD_BYTES if kind in LARGE_TYPES else MAX_OTHER_BYTES
    if channel.message_encoding == "json":
        most = MAX_JSON_BYTES
    if len(data) > most:
        return f"it has {len(data)} bytes, more than {most}"
    view = memoryview(data)
    try:
        if kind == ROS_CLOUD and channel.message_encoding == "cdr":
            return _too_many_fields(_cdr_fields(view))
        if kind == ROS_CLOUD and channel.message_encoding == "ros1":
            return _too_many_fields(_ros1_fields(view))
        if channel.message_encoding == "protobuf":
            return _too_many_parts(view)
    except (struct.error, IndexError):
        return ""  # it is cut, which the decoder also finds
    return ""


def _too_many_fields(fields: int) -> str:
    if fields <= MAX_FIELDS:
        return ""
    return f"it says that its points have {fields} fields, more than {MAX_FIELDS}"


def _cdr_fields(view: memoryview) -> int:
    """Read the number of fields behind header, height and width; CDR aligns to four bytes."""
    order = "<" if view[1] & 1 else ">"
    body = view[4:]
    (name_bytes,) = struct.unpack_from(f"{order}I", body, 8)
    at = -(-(12 + name_bytes) // 4) * 4
    return int(struct.unpack_from(f"{order}I", body, at + 8)[0])


def _ros1_fields(view: memoryview) -> int:
    (name_bytes,) = struct.unpack_from("<I", view, 12)
    return int(struct.unpack_from("<I", view, 16 + name_bytes + 8)[0])


def _too_many_parts(view: memoryview) -> str:
    """Count the members of a protobuf message, and the bytes of all but its largest one."""
    at, members, small_bytes, largest = 0, 0, 0, 0
    while at < len(view) and members <= MAX_FIELDS:
        start = at
        tag, at = _varint(view, at)
        wire = tag & 7
        if wire == 0:
            _, at = _varint(view, at)
        elif wire == 2:
            length, at = _varint(view, at)
            at += length
        elif wire in (1, 5):
            at += 8 if wire == 1 else 4
        else:
            return ""  # a group, or no protobuf at all, which the decoder reports
        members += 1
        small_bytes += at - start
        largest = max(largest, at - start)
    if members > MAX_FIELDS:
        return f"it has more than {MAX_FIELDS} members"
    if small_bytes - largest > MAX_OTHER_BYTES:
        return f"its members take more than {MAX_OTHER_BYTES} bytes, apart from the largest"
    return ""


def _varint(view: memoryview, at: int) -> tuple[int, int]:
    value, shift = 0, 0
    while True:
        byte = view[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
        if shift > 63:
            raise IndexError("no varint")
