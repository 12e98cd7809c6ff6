"""MCAP files of excerpts: chunked, compressed and indexed, as platforms for labelling require."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from mcap.writer import CompressionType, Writer

from schemas.excerpt import ExcerptChannel, ExcerptMessage

CHUNK_BYTES: Final = 4 * 1024 * 1024
"""Bytes of a chunk before compression: a player reads one or two of them for each frame."""

LIBRARY: Final = "counterpoint"


def write_mcap(
    path: Path,
    messages: Iterable[ExcerptMessage],
    *,
    metadata: Iterable[tuple[str, Mapping[str, str]]],
    attachments: Iterable[tuple[str, str, bytes]],
) -> None:
    """Write messages, metadata and attachments; every payload is written unchanged.

    The file has no profile, since recorded messages and overlays have different encodings.

    Args:
        path: The file.
        messages: Its messages.
        metadata: Name and content of each metadata record.
        attachments: Name, media type and bytes of each attachment.
    """
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile="", library=LIBRARY)
        channels = _Channels(writer)
        first_ns = 0
        for message in messages:
            first_ns = first_ns or message.log_time_ns
            writer.add_message(
                channels.id_of(message.channel),
                log_time=message.log_time_ns,
                publish_time=message.publish_time_ns,
                data=message.data,
            )
        for name, media_type, data in attachments:
            writer.add_attachment(
                create_time=first_ns,
                log_time=first_ns,
                name=name,
                media_type=media_type,
                data=data,
            )
        for name, content in metadata:
            writer.add_metadata(name, dict(content))
        writer.finish()  # type: ignore[no-untyped-call]


class _Channels:
    """Ids of the channels and schemas of a file that is written."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._channels: dict[int, tuple[ExcerptChannel, int]] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}

    def id_of(self, channel: ExcerptChannel) -> int:
        """Return the id of a channel; one that is new is registered."""
        known = self._channels.get(id(channel))
        if known is not None:
            return known[1]
        schema_id = 0
        if channel.schema_name or channel.schema_data:
            schema = (channel.schema_name, channel.schema_encoding, channel.schema_data)
            if schema not in self._schemas:
                self._schemas[schema] = self._writer.register_schema(*schema)
            schema_id = self._schemas[schema]
        number = self._writer.register_channel(
            channel.topic, channel.message_encoding, schema_id, dict(channel.metadata)
        )
        self._channels[id(channel)] = (channel, number)
        return number
