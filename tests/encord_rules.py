"""Rules that Encord publishes for MCAP scenes, checked on a file by the `mcap` reader.

The rules are those of https://docs.encord.com/platform-documentation/Curate/add-files/mcap, as
read in November 2026. Its list of supported schemas is Encord's to change; what is checked here is
that a program which knows the well-known schemas finds and decodes them.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from mcap_protobuf.decoder import DecoderFactory as Protobuf
from mcap_ros2.decoder import DecoderFactory as Ros2

OVERLAY: Final = "/counterpoint/points"
ENCODINGS: Final = frozenset(
    {("protobuf", "protobuf"), ("cdr", "ros2msg"), ("ros1", "ros1msg"), ("json", "jsonschema")}
)
"""Pairs of message and schema encoding in MCAP's registry that recorders of vehicles write."""

CLOUDS: Final = frozenset({"foxglove.PointCloud", "sensor_msgs/msg/PointCloud2"})
IMAGES: Final = frozenset({"foxglove.CompressedImage", "sensor_msgs/msg/CompressedImage"})
TRANSFORMS: Final = frozenset(
    {"foxglove.FrameTransform", "foxglove.FrameTransforms", "tf2_msgs/msg/TFMessage"}
)


def broken_rules(path: Path) -> list[str]:
    """Return a sentence for each rule that an MCAP file breaks; none if Encord can show it."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    if summary is None or not summary.chunk_indexes:
        return ["the file has no summary with chunk indexes"]
    unexplained = list(_schemas(summary))
    if unexplained:
        return unexplained
    return [*_chunks(path, summary), *_timeline(path, summary), *_transforms(path)]


def _chunks(path: Path, summary: Summary) -> Iterator[str]:
    """Check that every message is in a chunk, and that the indexes lead to each of them."""
    with path.open("rb") as file:
        outside = [
            each
            for each in StreamReader(file, emit_chunks=True).records
            if isinstance(each, Message)
        ]
    if outside:
        yield f"{len(outside)} messages are outside chunks"
    indexed = sum(1 for _ in _messages(path))
    with path.open("rb") as file:
        stored = sum(isinstance(each, Message) for each in StreamReader(file).records)
    counted = summary.statistics.message_count if summary.statistics else -1
    if not indexed == stored == counted:
        yield f"the indexes lead to {indexed} of {stored} messages; the statistics count {counted}"
    for each in summary.chunk_indexes:
        if each.compression not in {"", "lz4", "zstd"}:
            yield f"the chunk at {each.chunk_start_offset} has compression {each.compression!r}"
        if not each.message_index_offsets:
            yield f"the chunk at {each.chunk_start_offset} has no message indexes"


def _schemas(summary: Summary) -> Iterator[str]:
    """Check that a reader finds the schema of every topic, and the well-known ones among them."""
    names = set()
    for channel in summary.channels.values():
        schema = summary.schemas.get(channel.schema_id)
        if schema is None or not schema.name:
            yield f"{channel.topic} has no schema"
            continue
        names.add(schema.name)
        if (channel.message_encoding, schema.encoding) not in ENCODINGS:
            yield f"{channel.topic} is {channel.message_encoding} by {schema.encoding}"
        if schema.encoding == "protobuf" and schema.name not in _described(schema):
            yield f"the schema of {channel.topic} does not describe {schema.name}"
    if not names & CLOUDS:
        yield "no topic has a schema of point clouds"


def _described(schema: Schema) -> set[str]:
    """Return the names of the messages that a set of descriptors explains."""
    described = FileDescriptorSet.FromString(schema.data)
    return {f"{file.package}.{each.name}" for file in described.file for each in file.message_type}


def _timeline(path: Path, summary: Summary) -> Iterator[str]:
    """Check log times: in order, one continuous scene, and one message of a cloud at each.

    Segmentations are stored at `stream@log_time`, so a log time identifies one cloud of a stream.
    """
    with path.open("rb") as file:
        times = [e.log_time for e in StreamReader(file).records if isinstance(e, Message)]
    if times != sorted(times):
        yield "the messages are not in the order of their log times"
    counted = summary.statistics
    if counted and (counted.message_start_time, counted.message_end_time) != (
        min(times),
        max(times),
    ):
        yield "the statistics have another begin or end"
    clouds: dict[str, list[int]] = {}
    for schema, channel, message in _messages(path):
        if schema.name in CLOUDS:
            clouds.setdefault(channel.topic, []).append(message.log_time)
    for topic, found in clouds.items():
        if max(Counter(found).values()) > 1:
            yield f"{topic} has two clouds at one log time"
    recorded = {t for topic, found in clouds.items() if topic != OVERLAY for t in found}
    if not set(clouds.get(OVERLAY, [])) <= recorded:
        yield f"{OVERLAY} has a log time at which nothing was recorded"
    seconds = (max(times) - min(times)) / 1e9
    if recorded and seconds > (max(recorded) - min(recorded)) / 1e9 + 2.0:
        yield f"the scene lasts {seconds:.1f} s, much longer than its clouds"


def _transforms(path: Path) -> Iterator[str]:
    """Check that transforms known by then connect all sensors whenever the overlay is shown."""
    parents: dict[str, str] = {}
    sensors: set[str] = set()
    shown_ns = {m.log_time for _, c, m in _messages(path) if c.topic == OVERLAY}
    for schema, channel, message, decoded in _decoded(path):
        if schema.name in TRANSFORMS:
            for child, parent in _stated(decoded):
                if parents.setdefault(child, parent) != parent:
                    yield f"{child} is a child of {parents[child]} and of {parent}"
        elif schema.name in CLOUDS | IMAGES:
            frame = getattr(decoded, "frame_id", "") or decoded.header.frame_id
            if not frame:
                yield f"{channel.topic} names no frame"
            sensors.add(frame)
            if message.log_time in shown_ns and channel.topic == OVERLAY:
                roots = {_root(each, parents) for each in sensors}
                if len(roots) > 1:
                    yield f"no transform connects {', '.join(sorted(roots))} at {message.log_time}"
    unknown = {_root(each, parents) for each in sensors}
    if len(unknown) > 1:
        yield f"no transform connects {', '.join(sorted(unknown))}"


def _root(frame: str, parents: Mapping[str, str]) -> str:
    seen = [frame]
    while (parent := parents.get(seen[-1])) is not None:
        if parent in seen:
            return f"the circle of {parent}"
        seen.append(parent)
    return seen[-1]


def _stated(message: Any) -> Iterator[tuple[str, str]]:
    """Yield child and parent of each transform of a message."""
    for each in getattr(message, "transforms", None) or [message]:
        if hasattr(each, "parent_frame_id"):
            yield each.child_frame_id, each.parent_frame_id
        else:
            yield each.child_frame_id, each.header.frame_id


def _messages(path: Path) -> Iterator[tuple[Schema, Channel, Message]]:
    """Yield the messages that the indexes of the file lead to, by log time."""
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            yield schema, channel, message


def _decoded(path: Path) -> Iterator[tuple[Schema, Channel, Message, Any]]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[Protobuf(), Ros2()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema is not None
            yield schema, channel, message, decoded
