"""The topics of a recording, put together from the channels of its parts."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from schemas.work import Channel
from workers.ingest.index import IndexedChunk, PartIndex


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a recording, over all its parts.

    Attributes:
        channel: Enough to decode its messages.
        messages: How many there are by the index; -1 where it does not say.
    """

    channel: Channel
    messages: int


def topics_of(indexes: Sequence[PartIndex]) -> tuple[Topic, ...]:
    """Put the channels of all parts together, in the order of their names.

    The same topic recorded with another encoding or type is a topic of its own here.
    """
    ids: dict[tuple[str, str, str, str], list[tuple[int, int]]] = {}
    schemas: dict[tuple[str, str, str, str], str] = {}
    messages: dict[tuple[str, str, str, str], int] = {}
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
                schemas.setdefault(kind, base64.b64encode(schema.data).decode("ascii"))
            known, count = messages.get(kind, 0), counts.get(channel_id, -1)
            messages[kind] = -1 if -1 in (known, count) else known + count
    return tuple(
        Topic(
            channel=Channel(
                topic=topic,
                message_encoding=message_encoding,
                schema_name=schema_name,
                schema_encoding=schema_encoding,
                schema_base64=schemas.get(kind, ""),
                ids=tuple(ids[kind]),
            ),
            messages=messages[kind],
        )
        for kind in sorted(ids)
        for topic, message_encoding, schema_name, schema_encoding in [kind]
    )


def channel_counts(index: PartIndex) -> Mapping[int, int]:
    """Messages by channel id of one part; -1 where the index does not say."""
    if index.message_counts:
        return {each: index.message_counts.get(each, 0) for each in index.channels}
    counts = dict.fromkeys(index.channels, 0)
    for chunk in index.chunks:
        for channel_id in counts:
            found = -1 if chunk.counts is None else chunk.counts.get(channel_id, 0)
            known = counts[channel_id]
            counts[channel_id] = -1 if -1 in (known, found) else known + found
    return counts


def ids_in(channel: Channel, part: int) -> frozenset[int]:
    """Channel ids that a topic goes by in one part."""
    return frozenset(channel_id for number, channel_id in channel.ids if number == part)


def chunks_of(channel: Channel, indexes: Sequence[PartIndex]) -> list[IndexedChunk]:
    """Chunks that may hold a topic's messages, earliest first."""
    found = [
        chunk
        for index in indexes
        for ids in [ids_in(channel, index.number)]
        if ids
        for chunk in index.chunks
        if chunk.may_hold(ids)
    ]
    return sorted(found, key=lambda each: (each.ref.start_ns, each.ref.part, each.ref.offset))


def count_in(chunk: IndexedChunk, channel: Channel) -> int:
    """Messages of a topic in a chunk; -1 where the index does not say."""
    if chunk.counts is None:
        return -1
    counts = [chunk.counts.get(each, 0) for each in ids_in(channel, chunk.ref.part)]
    return -1 if -1 in counts else sum(counts)
