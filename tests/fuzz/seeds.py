"""The logs that are mutated: a second of a street in six encodings, in any container."""

import random
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final

from mcap.opcode import Opcode

from schemas.arrays import NS_PER_S
from tests.fuzz import clouds
from tests.fuzz.clouds import Encoder
from tests.fuzz.container import Container, Draft, Record, channel, message, metadata, schema
from workers.ingest.ros_definitions import ROS1_DEFINITIONS, ROS2_DEFINITIONS

BEGIN_NS: Final = 1_700_000_000 * NS_PER_S
FRAMES: Final = 10
STEP_NS: Final = NS_PER_S // 10
CLOUD: Final = "sensor_msgs/PointCloud2"
LIDAR, LABELS, MOVED = 1, 2, 3
"""Channel ids, and those of their schemas."""


@dataclass(frozen=True, slots=True)
class Encoding:
    """How clouds lie in a log.

    Attributes:
        write: Rows and stamp to a message.
        message_encoding: Of the channel.
        schema_name: Type of the messages.
        schema_encoding: Of the schema.
        schema: Its text or bytes.
        labels: Whether the labels of the model on the car are fields of the clouds; else they lie
            on a topic of their own, beside the motion that the car recorded.
    """

    write: Encoder
    message_encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes
    labels: bool = True


def _ros2(write: Encoder, *, labels: bool = True) -> Encoding:
    definition = ROS2_DEFINITIONS[CLOUD].encode()
    return Encoding(write, "cdr", "sensor_msgs/msg/PointCloud2", "ros2msg", definition, labels)


ENCODINGS: Final[Mapping[str, Encoding]] = {
    "ros2": _ros2(clouds.cdr),
    "ros2 big-endian": _ros2(clouds.cdr_big_endian),
    "ros2 labels apart": _ros2(clouds.cdr, labels=False),
    "ros1": Encoding(clouds.ros1, "ros1", CLOUD, "ros1msg", ROS1_DEFINITIONS[CLOUD].encode()),
    "protobuf": Encoding(
        clouds.protobuf,
        "protobuf",
        "foxglove.PointCloud",
        "protobuf",
        clouds.protobuf_schema(),
    ),
    "json": Encoding(
        clouds.foxglove_json, "json", "foxglove.PointCloud", "jsonschema", b'{"type": "object"}'
    ),
}

CONTAINERS: Final = (
    Container("zstd"),
    Container("lz4"),
    Container(""),
    Container("zstd", indexed=False),
    Container("lz4", indexed=False),
    Container("", chunked=False),
    Container("", chunked=False, indexed=False),
    Container("zstd", chunk_bytes=1 << 20),
)


def seed_log(encoding: str, container: Container, *, late_ms: int = 5, pause_ms: int = 0) -> Draft:
    """Make the log of an encoding, unharmed.

    Args:
        encoding: One of `ENCODINGS`.
        container: How its records are put in a file.
        late_ms: Log times are so much after the stamps.
        pause_ms: Silence in its middle, beside that between two frames.
    """
    records = _records(encoding, late_ms, pause_ms)
    return Draft([Record(*each) for each in records], container)


def any_seed(chance: random.Random, encoding: str) -> Draft:
    """Make it in a container of a random kind; one in four is silent for some shards."""
    return seed_log(
        encoding,
        chance.choice(CONTAINERS),
        late_ms=chance.choice((0, 5, 20, 90)),
        pause_ms=chance.choice((0, 0, 0, 700)),
    )


@cache
def _records(name: str, late_ms: int, pause_ms: int) -> tuple[tuple[int, bytes], ...]:
    made = ENCODINGS[name]
    said = [
        metadata("counterpoint.log", {"vehicle": "car-7", "date": "2026-03-02"}),
        metadata("counterpoint.classes", clouds.CLASSES),
        schema(LIDAR, made.schema_name, made.schema_encoding, made.schema),
        channel(LIDAR, LIDAR, "/lidar/points", made.message_encoding),
    ]
    if not made.labels:
        twist = ROS2_DEFINITIONS["geometry_msgs/TwistStamped"].encode()
        said += [
            channel(LABELS, LIDAR, "/lidar/labels", made.message_encoding),
            schema(MOVED, "geometry_msgs/msg/TwistStamped", "ros2msg", twist),
            channel(MOVED, MOVED, "/vehicle/twist", made.message_encoding),
        ]
    for number in range(FRAMES):
        paused_ns = pause_ms * 1_000_000 * (number >= FRAMES // 2)
        rows, stamp_ns = clouds.street(number), BEGIN_NS + number * STEP_NS + paused_ns
        late_ns = stamp_ns + late_ms * 1_000_000
        if made.labels:
            said.append(message(LIDAR, number, late_ns, made.write(rows, stamp_ns)))
            continue
        bare, labels = clouds.without(rows, clouds.LABELS), clouds.labels_of(rows)
        said += [
            message(LIDAR, number, late_ns, made.write(bare, stamp_ns)),
            message(LABELS, number, late_ns + 1, made.write(labels, stamp_ns)),
            message(MOVED, number, late_ns, _twist(stamp_ns)),
        ]
    return tuple((Opcode(record.opcode), record.body) for record in said)


def _twist(stamp_ns: int) -> bytes:
    head = struct.pack("<iII", stamp_ns // NS_PER_S, stamp_ns % NS_PER_S, 5) + b"base\0"
    head += bytes(-len(head) % 8)
    return b"\0\1\0\0" + head + struct.pack("<6d", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
