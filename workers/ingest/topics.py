"""Topics of a recording, merged from the channels of its parts."""

import base64
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from schemas.bounds import MAX_NAME, MAX_TOPIC
from schemas.visible import has_controls, visible
from schemas.work import Channel
from workers.ingest.index import IndexedChunk, PartIndex
from workers.ingest.limits import MAX_IDS, MAX_SCHEMA_TEXT


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a recording, over all its parts.

    Attributes:
        channel: Enough to decode its messages.
        messages: Number of messages by the index; -1 where unknown.
    """

    channel: Channel
    messages: int


def topics_of(
    indexes: Sequence[PartIndex],
    *,
    on_left_out: Callable[[Channel, str], None] = lambda channel, why: None,
) -> tuple[Topic, ...]:
    """Merge the channels of all parts, in the order of their names.

    The same topic recorded with another encoding or type is a topic of its own here.

    Args:
        indexes: Of all parts.
        on_left_out: Called with each topic whose name cannot be mined, and the reason; the channel
            has that name escaped and cut.
    """
    ids: dict[tuple[str, str, str, str], list[tuple[int, int]]] = {}
    schemas: dict[tuple[str, str, str, str], str] = {}
    messages: dict[tuple[str, str, str, str], int] = {}
    encoded: dict[tuple[int, int], str] = {}
    for index in indexes:
        counts = channel_counts(index)
        for channel_id in sorted(index.channels):
            channel = index.channels[channel_id]
            schema = index.schemas.get(channel.schema_id)
            kind = (
                channel.topic,
                channel.message_encoding,
                schema.name if schema else "",
                schema.encoding if schema else "",
            )
            ids.setdefault(kind, []).append((index.number, channel_id))
            if schema is not None:
                known_as = (index.number, schema.id)  # many channels may have one schema
                if known_as not in encoded:
                    encoded[known_as] = base64.b64encode(schema.data).decode("ascii")
                schemas.setdefault(kind, encoded[known_as])
            known, count = messages.get(kind, 0), counts.get(channel_id, -1)
            messages[kind] = -1 if -1 in (known, count) else known + count
    found: list[Topic] = []
    for kind in sorted(ids):
        topic, message_encoding, schema_name, schema_encoding = kind
        text = schemas.get(kind, "")
        why = _unusable(topic, len(ids[kind]))
        if message_encoding == "protobuf" and len(text) > MAX_SCHEMA_TEXT:
            why = why or f"has a schema of more than {MAX_SCHEMA_TEXT} characters in base64"
        described = Channel(
            topic=visible(topic, limit=MAX_TOPIC) or "-",
            message_encoding=visible(message_encoding, limit=MAX_NAME),
            schema_name=visible(schema_name, limit=MAX_NAME),
            schema_encoding=visible(schema_encoding, limit=MAX_NAME),
            schema_base64=text if len(text) <= MAX_SCHEMA_TEXT else "",
            ids=tuple(ids[kind][:MAX_IDS]),
        )
        if why:
            on_left_out(described, why)
        else:
            found.append(Topic(channel=described, messages=messages[kind]))
    return tuple(found)


def _unusable(topic: str, channels: int) -> str:
    """Return why a topic of this name is not mined; empty if it is."""
    if not topic.strip("/"):
        return "has no name"
    if len(topic) > MAX_TOPIC:
        return f"has a name of {len(topic)} characters, more than {MAX_TOPIC}"
    if channels > MAX_IDS:
        return f"goes by {channels} channels, more than {MAX_IDS}"
    return "has control characters in its name" if has_controls(topic) else ""


def channel_counts(index: PartIndex) -> Mapping[int, int]:
    """Count messages by channel id of one part; -1 where the index does not state them."""
    if index.message_counts:
        return {each: index.message_counts.get(each, 0) for each in index.channels}
    counts: Counter[int] = Counter()
    unknown: set[int] = set()
    for chunk in index.chunks:
        if chunk.counts is None:
            return dict.fromkeys(index.channels, -1)
        for channel_id, found in chunk.counts.items():
            counts[channel_id] += found
            if found == -1:
                unknown.add(channel_id)
    return {each: -1 if each in unknown else counts[each] for each in index.channels}


def ids_in(channel: Channel, part: int) -> frozenset[int]:
    """Return the channel ids of a topic in one part."""
    return frozenset(channel_id for number, channel_id in channel.ids if number == part)


def chunks_of(channel: Channel, indexes: Sequence[PartIndex]) -> list[IndexedChunk]:
    """Return chunks that may have a topic's messages, earliest first."""
    found = [
        chunk
        for index in indexes
        for ids in [ids_in(channel, index.number)]
        if ids
        for chunk in index.chunks
        if chunk.may_contain(ids)
    ]
    return sorted(found, key=lambda each: (each.ref.start_ns, each.ref.part, each.ref.offset))


def count_in(chunk: IndexedChunk, channel: Channel) -> int:
    """Count messages of a topic in a chunk; -1 where the index does not state them."""
    if chunk.counts is None:
        return -1
    counts = [chunk.counts.get(each, 0) for each in ids_in(channel, chunk.ref.part)]
    return -1 if -1 in counts else sum(counts)


def without_schema(channel: Channel) -> Channel:
    """Drop the schema of ROS and JSON clouds, which are decoded without it."""
    if channel.message_encoding == "protobuf":
        return channel
    return channel.model_copy(update={"schema_base64": ""})
