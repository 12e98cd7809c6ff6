"""What a part of a log holds and where, from its summary: one or two range reads, at most three."""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, TypeVar

from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from schemas.work import ChunkRef, Damage
from workers.errors import NotMcapError
from workers.ingest.footer import footer_of, read_tail
from workers.ingest.part import PartReader
from workers.ingest.records import (
    FOOTER_BYTES,
    HEADER_BYTES,
    MAGIC,
    RecordMalformedError,
    parse,
    walk,
)

MAX_SUMMARY_BYTES: Final = 128 * 1024 * 1024
MAX_METADATA_SPAN_BYTES: Final = 4 * 1024 * 1024
METADATA_NAMES: Final = ("counterpoint.log", "counterpoint.classes")
"""The metadata records that mean something here."""

Small = TypeVar("Small")


@dataclass(frozen=True, slots=True)
class IndexedChunk:
    """Where messages lie, and how many of each channel.

    Attributes:
        ref: The bytes to read, with the times inside.
        counts: Messages by channel id of the part, -1 where only their presence is known; None
            where nothing is.
    """

    ref: ChunkRef
    counts: Mapping[int, int] | None

    def may_hold(self, channel_ids: frozenset[int]) -> bool:
        """Whether messages of these channels may lie inside."""
        return self.counts is None or any(self.counts.get(each, 0) for each in channel_ids)


@dataclass(slots=True, eq=False)
class PartIndex:
    """What a part holds and where.

    Attributes:
        number: Index into the recording's parts.
        schemas: By id.
        channels: By id.
        chunks: In the order they lie in the object.
        metadata: The records named in `METADATA_NAMES`, in the order they were found.
        message_counts: Messages by channel id, where the log says so.
        damage: What cannot be read, as far as the index shows it.
        recovered: Whether it was rebuilt by looking through the object.
        closed: Whether the object ends as its writer meant it to.
    """

    number: int
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[IndexedChunk] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    message_counts: dict[int, int] = field(default_factory=dict)
    damage: list[Damage] = field(default_factory=list)
    recovered: bool = False
    closed: bool = True


@dataclass(slots=True, eq=False)
class Summary:
    """The records of a summary section, and where the data section before it ends."""

    start: int
    schemas: list[Schema] = field(default_factory=list)
    channels: list[Channel] = field(default_factory=list)
    chunk_indexes: list[ChunkIndex] = field(default_factory=list)
    attachment_indexes: list[AttachmentIndex] = field(default_factory=list)
    metadata_indexes: list[MetadataIndex] = field(default_factory=list)
    statistics: Statistics | None = None


def read_summary(reader: PartReader) -> Summary | None:
    """Read the summary of a part from its tail.

    Returns:
        Its records; None where there is no summary or the part was never closed.

    Raises:
        NotMcapError: If the object neither begins nor ends as an MCAP file does.
        RecordMalformedError: If there is a summary and it is damaged; the offset is the part's.
    """
    tail = read_tail(reader)
    if bytes(tail[-len(MAGIC) :]) != MAGIC:
        _refuse_other_formats(reader)
        return None
    footer = footer_of(tail)
    if footer is None or footer.summary_start == 0:
        return None
    footer_offset = len(tail) - len(MAGIC) - FOOTER_BYTES
    start, stop = footer.summary_start, reader.size - len(MAGIC) - FOOTER_BYTES
    if not len(MAGIC) <= start <= stop or stop - start > MAX_SUMMARY_BYTES:
        raise RecordMalformedError("the footer points outside the file", offset=stop)
    section = reader.read(start, stop - start)
    # The checksum covers the footer too, up to the checksum itself.
    if footer.summary_crc:
        crc = zlib.crc32(section)
        crc = zlib.crc32(tail[footer_offset : footer_offset + FOOTER_BYTES - 4], crc)
        if crc != footer.summary_crc:
            raise RecordMalformedError("the summary's checksum is wrong", offset=start)
    try:
        return _summary(start, section)
    except RecordMalformedError as error:
        raise RecordMalformedError(error.problem, offset=start + error.offset) from None


def index_of(summary: Summary, reader: PartReader) -> PartIndex:
    """Make a part's index from its summary; metadata may cost a read more."""
    index = PartIndex(number=reader.number)
    for schema in summary.schemas:
        index.schemas.setdefault(schema.id, schema)
    for channel in summary.channels:
        index.channels.setdefault(channel.id, channel)
    seen: set[int] = set()
    for entry in sorted(summary.chunk_indexes, key=lambda each: each.chunk_start_offset):
        offset, length = entry.chunk_start_offset, entry.chunk_length
        if offset in seen:
            continue
        seen.add(offset)
        if offset < len(MAGIC) or length <= HEADER_BYTES or offset + length > summary.start:
            index.damage.append(
                Damage(
                    key=reader.key,
                    offset=min(offset, reader.size),
                    bytes=0,
                    what="the index names a chunk outside the data of the file",
                )
            )
            continue
        index.chunks.append(_indexed_chunk(entry, reader.number))
    if summary.statistics is not None:
        index.message_counts = dict(summary.statistics.channel_message_counts)
    read_metadata(summary, reader, index)
    return index


def read_metadata(summary: Summary, reader: PartReader, index: PartIndex) -> None:
    """Read the metadata records that mean something here, those that lie together in one read."""
    wanted = sorted(
        (each for each in summary.metadata_indexes if each.name in METADATA_NAMES),
        key=lambda each: each.offset,
    )
    if not wanted:
        return
    first, last = wanted[0].offset, max(each.offset + each.length for each in wanted)
    if last <= reader.size and last - first <= MAX_METADATA_SPAN_BYTES:
        reader.read(first, last - first)
    for each in wanted:
        try:
            if each.length > MAX_METADATA_SPAN_BYTES:
                raise RecordMalformedError("a metadata record is too large to be one")
            record = _single(reader.read(each.offset, each.length), Opcode.METADATA)
            index.metadata.append(parse(Metadata, record))
        except RecordMalformedError as error:
            index.damage.append(
                Damage(
                    key=reader.key,
                    offset=min(each.offset, reader.size),
                    bytes=0,
                    what=f"metadata record {each.name!r} cannot be read: {error.problem}",
                )
            )


def _summary(start: int, section: memoryview) -> Summary:
    summary = Summary(start=start)
    for record in walk(section):
        match record.opcode:
            case Opcode.SCHEMA:
                summary.schemas.append(parse(Schema, record.body))
            case Opcode.CHANNEL:
                summary.channels.append(parse(Channel, record.body))
            case Opcode.CHUNK_INDEX:
                summary.chunk_indexes.append(parse(ChunkIndex, record.body))
            case Opcode.ATTACHMENT_INDEX:
                summary.attachment_indexes.append(parse(AttachmentIndex, record.body))
            case Opcode.METADATA_INDEX:
                summary.metadata_indexes.append(parse(MetadataIndex, record.body))
            case Opcode.STATISTICS:
                summary.statistics = parse(Statistics, record.body)
            case _:
                pass
    return summary


def _indexed_chunk(entry: ChunkIndex, part: int) -> IndexedChunk:
    start, end = sorted((entry.message_start_time, entry.message_end_time))
    return IndexedChunk(
        ref=ChunkRef(
            part=part,
            offset=entry.chunk_start_offset,
            length=entry.chunk_length,
            start_ns=start,
            end_ns=end,
        ),
        counts=_counts(entry),
    )


def _counts(entry: ChunkIndex) -> dict[int, int] | None:
    """Count messages by the lengths of their MessageIndex records, which follow each other."""
    if not entry.message_index_offsets:
        return {} if entry.message_start_time == entry.message_end_time == 0 else None
    by_offset = sorted((offset, each) for each, offset in entry.message_index_offsets.items())
    ends = [offset for offset, _ in by_offset[1:]]
    ends.append(entry.chunk_start_offset + entry.chunk_length + entry.message_index_length)
    counts: dict[int, int] = {}
    for (offset, channel_id), end in zip(by_offset, ends, strict=True):
        entries_bytes = end - offset - HEADER_BYTES - 6
        exact = entries_bytes >= 0 and entries_bytes % 16 == 0
        counts[channel_id] = entries_bytes // 16 if exact else -1
    return counts


def _single(view: memoryview, opcode: Opcode) -> memoryview:
    for record in walk(view):
        if record.opcode == opcode:
            return record.body
        break
    raise RecordMalformedError(f"there is no {opcode.name} record where one should be")


def _refuse_other_formats(reader: PartReader) -> None:
    head = bytes(reader.read(0, len(MAGIC)))
    if head == MAGIC:
        return
    where = f"({reader.bucket.url.rstrip('/')}/{reader.key})"
    if not reader.size:
        raise NotMcapError(f"the file is empty {where}")
    if head[:4] in (b"\x28\xb5\x2f\xfd", b"\x04\x22\x4d\x18") or head[:2] == b"\x1f\x8b":
        raise NotMcapError(
            f"the file is compressed as a whole: decompress it before upload {where}"
        )
    if head[:5] == MAGIC[:5]:
        raise NotMcapError(
            f"the file is of an MCAP version that is not read here, or its first bytes are "
            f"damaged {where}"
        )
    raise NotMcapError(f"the file is no MCAP file {where}")
