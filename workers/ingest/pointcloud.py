"""Point clouds from messages: stamp, space, and fields as arrays."""

import binascii
from base64 import b64decode
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Transform
from workers.errors import CloudUnreadableError
from workers.ingest.cloud_kinds import is_cloud, unsupported_reason
from workers.ingest.decoding import MessageUnreadableError, decode_message
from workers.ingest.limits import MAX_POINTS
from workers.ingest.messages import RawMessage
from workers.ingest.pointcloud_fields import (
    FOXGLOVE_TYPES,
    ROS_TYPES,
    Layout,
    packed_field,
    unpack,
)
from workers.ingest.transforms import member, rigid

LABEL_FIELD: Final = "label"
"""Class ids of a model: a cloud of labels alone has no positions of its own."""

__all__ = ["LABEL_FIELD", "DecodedCloud", "decode_cloud", "is_cloud", "unsupported_reason"]


@dataclass(frozen=True, slots=True, eq=False)
class DecodedCloud:
    """A point cloud as recorded: nothing is renamed, scaled, dropped or reordered.

    Attributes:
        stamp_ns: Time of its header, nanoseconds since the Unix epoch; 0 where it is zero.
        frame_id: The space of its points, by the log's own name.
        points: Number of points, invalid ones included.
        height: Rows of an organised cloud, else 1.
        fields: Name to (N,) array, (N, count) for several elements, in the message's byte order.
        data: The packed bytes that the fields are views of.
        space_from_points: (4, 4) origin of the points in the space of `frame_id`, which Foxglove's
            clouds may state; None where they are the same.
    """

    stamp_ns: int
    frame_id: str
    points: int
    height: int
    fields: Mapping[str, NDArray[Any]]
    data: bytes
    space_from_points: Transform | None = None

    def __len__(self) -> int:
        """Count the points, invalid ones included."""
        return self.points


def decode_cloud(message: RawMessage) -> DecodedCloud:
    """Decode a point cloud of any encoding that `is_cloud` accepts.

    An empty cloud is well-formed and has no points.

    Raises:
        CloudUnreadableError: If its type is not supported, its bytes do not match the schema, its
            sizes contradict each other, or its points have neither positions nor labels.
    """
    channel = message.channel
    if not is_cloud(channel):
        needs = unsupported_reason(channel) or f"holds {channel.schema_name}"
        raise CloudUnreadableError(f"cannot read cloud: {channel.topic} {needs}")
    read = _READERS[channel.message_encoding]
    try:
        cloud = read(decode_message(message))
    except MessageUnreadableError as error:
        raise CloudUnreadableError(str(error)) from error
    except CloudUnreadableError as error:
        raise CloudUnreadableError(
            f"{error} ({channel.topic}, logged at {message.log_time_ns})"
        ) from error
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise CloudUnreadableError(
            f"cannot read cloud: {channel.schema_name} without what the type needs: "
            f"{type(error).__name__}: {error} ({channel.topic}, logged at {message.log_time_ns})"
        ) from error
    if len(cloud) > MAX_POINTS:
        raise CloudUnreadableError(
            f"cannot read cloud: it has {len(cloud)} points, more than {MAX_POINTS} "
            f"({channel.topic}, logged at {message.log_time_ns})"
        )
    missing = [name for name in "xyz" if name not in cloud.fields]
    if missing and len(cloud) and LABEL_FIELD not in cloud.fields:
        raise CloudUnreadableError(
            f"cannot read cloud: no field {', '.join(missing)}; fields are "
            f"{', '.join(sorted(cloud.fields))} ({channel.topic}, logged at {message.log_time_ns})"
        )
    return cloud


def _ros1(message: Any) -> DecodedCloud:
    stamp = message.header.stamp
    return _ros(message, stamp.secs * NS_PER_S + stamp.nsecs)


def _ros2(message: Any) -> DecodedCloud:
    stamp = message.header.stamp
    return _ros(message, stamp.sec * NS_PER_S + stamp.nanosec)


def _ros(message: Any, stamp_ns: int) -> DecodedCloud:
    layout = Layout(
        width=message.width,
        height=message.height,
        point_step_bytes=message.point_step,
        row_step_bytes=message.row_step,
        big_endian=bool(message.is_bigendian),
        fields=tuple(
            packed_field(
                field.name,
                offset=field.offset,
                kind=field.datatype,
                count=field.count,
                types=ROS_TYPES,
            )
            for field in message.fields
        ),
    )
    return _cloud(stamp_ns, message.header.frame_id, message.data, layout)


def _foxglove_protobuf(message: Any) -> DecodedCloud:
    stamp_ns = message.timestamp.seconds * NS_PER_S + message.timestamp.nanos
    fields = [(field.name, field.offset, field.type) for field in message.fields]
    posed = hasattr(message, "pose") and message.HasField("pose")
    return _foxglove(
        stamp_ns,
        message.frame_id,
        message.data,
        message.point_stride,
        fields,
        message.pose if posed else None,
    )


def _foxglove_json(message: Any) -> DecodedCloud:
    stamp = message["timestamp"]
    fields = [(field["name"], field.get("offset", 0), field["type"]) for field in message["fields"]]
    try:
        data = b64decode(message["data"], validate=True)
    except binascii.Error as error:
        raise CloudUnreadableError(f"cannot read cloud: its data is no base64: {error}") from error
    return _foxglove(
        int(stamp["sec"]) * NS_PER_S + int(stamp["nsec"]),
        str(message["frame_id"]),
        data,
        int(message["point_stride"]),
        fields,
        message.get("pose"),
    )


def _foxglove(
    stamp_ns: int,
    frame_id: str,
    data: bytes,
    stride: int,
    fields: list[tuple[str, int, int]],
    pose: Any,
) -> DecodedCloud:
    """Decode a cloud whose number of points follows from its size alone."""
    if data and stride <= 0:
        raise CloudUnreadableError(f"cannot read cloud: point_stride is {stride}")
    points, rest = divmod(len(data), stride) if data else (0, 0)
    if rest:
        raise CloudUnreadableError(
            f"cannot read cloud: {len(data)} bytes are no whole number of points of {stride} bytes"
        )
    layout = Layout(
        width=points,
        height=1,
        point_step_bytes=stride,
        row_step_bytes=0,
        big_endian=False,
        fields=tuple(
            packed_field(name, offset=offset, kind=kind, count=1, types=FOXGLOVE_TYPES)
            for name, offset, kind in fields
        ),
    )
    return _cloud(stamp_ns, frame_id, data, layout, _origin(pose))


def _origin(pose: Any) -> Transform | None:
    """Read the pose of a cloud in its space; None where it is that space's origin."""
    if pose is None:
        return None
    position, orientation = member(pose, "position"), member(pose, "orientation")
    space_from_points = rigid(
        tuple(float(member(position, axis)) for axis in "xyz"),
        tuple(float(member(orientation, axis)) for axis in "xyzw"),
    )
    return None if np.array_equal(space_from_points, np.eye(4)) else space_from_points


def _cloud(
    stamp_ns: int,
    frame_id: str,
    data: bytes,
    layout: Layout,
    space_from_points: Transform | None = None,
) -> DecodedCloud:
    return DecodedCloud(
        stamp_ns=max(stamp_ns, 0),
        frame_id=frame_id,
        points=layout.width * layout.height,
        height=layout.height,
        fields=unpack(data, layout),
        data=data,
        space_from_points=space_from_points,
    )


_READERS: Mapping[str, Callable[[Any], DecodedCloud]] = {
    "cdr": _ros2,
    "ros1": _ros1,
    "protobuf": _foxglove_protobuf,
    "json": _foxglove_json,
}
