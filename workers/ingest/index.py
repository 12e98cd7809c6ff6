"""Part index from the MCAP summary, with one or two range reads, at most three."""

import zlib
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

from schemas.bounds import MAX_INTEGER
from schemas.work import ChunkRef
from workers.errors import LogUnusableError, NotMcapError
from workers.ingest.damage import DamageList, damaged
from workers.ingest.footer import footer_of, read_tail
from workers.ingest.limits import (
    MAX_CHANNELS_BYTES,
    MAX_CHUNKS,
    MAX_COUNTED,
    MAX_METADATA_BYTES,
    MAX_SCHEMA_BYTES,
    MAX_SCHEMAS_BYTES,
    MAX_SMALL_BYTES,
    MAX_SUMMARY_RECORDS,
)
from workers.ingest.part_reader import PartReader
from workers.ingest.records import (
    FOOTER_BYTES,
    HEADER_BYTES,
    MAGIC,
    Record,
    RecordMalformedError,
    parse,
    walk,
)

MAX_SUMMARY_BYTES: Final = 128 * 1024 * 1024
"""Bytes of a summary at most; a longer one is invalid."""

MAX_METADATA_SPAN_BYTES: Final = 4 * 1024 * 1024
METADATA_NAMES: Final = ("counterpoint.log", "counterpoint.classes")
"""Names of the metadata records that are read."""

Small = TypeVar("Small")


@dataclass(frozen=True, slots=True)
class IndexedChunk:
    """A chunk's bytes, and its number of messages per channel.

    Attributes:
        ref: The bytes to read, with the times inside.
        counts: Messages by channel id of the part, -1 where only their presence is known; None
            where nothing is.
    """

    ref: ChunkRef
    counts: dict[int, int] | None

    def may_contain(self, channel_ids: frozenset[int]) -> bool:
        """Return True unless the index excludes messages of these channels."""
        return self.counts is None or any(self.counts.get(each, 0) for each in channel_ids)


@dataclass(slots=True, eq=False)
class PartIndex:
    """Contents of a part and their places.

    Attributes:
        number: Index into the recording's parts.
        schemas: By id.
        channels: By id.
        chunks: In the order of the object.
        metadata: The records named in `METADATA_NAMES`, in the order they were found.
        message_counts: Messages by channel id, where the log states them.
        damage: Stretches that cannot be read, as far as the index shows.
        recovered: It was rebuilt by a scan of the object.
        closed: The object ends with a valid footer.
    """

    number: int
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[IndexedChunk] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    message_counts: dict[int, int] = field(default_factory=dict)
    damage: DamageList = field(default_factory=DamageList)
    recovered: bool = False
    closed: bool = True
    _channels_bytes: int = 0
    _schemas_bytes: int = 0
    _metadata_bytes: int = 0

    def add_chunk(self, chunk: IndexedChunk) -> None:
        """Add a chunk.

        Raises:
            LogUnusableError: If there are more than any recording has.
        """
        if len(self.chunks) >= MAX_CHUNKS:
            raise too_many_chunks()
        self.chunks.append(chunk)

    def add_record(self, record: Record) -> None:
        """Add a schema or a channel that is not known yet; other records are ignored.

        Raises:
            RecordMalformedError: If it is malformed, or if there are more than any log has.
        """
        if record.opcode == Opcode.SCHEMA:
            check_size(record.opcode, len(record.body))
            schema = parse(Schema, record.body)
            if schema.id not in self.schemas:
                self._schemas_bytes += len(record.body)
                if self._schemas_bytes > MAX_SCHEMAS_BYTES:
                    raise RecordMalformedError(f"its schemas take over {MAX_SCHEMAS_BYTES} bytes")
                self.schemas[schema.id] = schema
        elif record.opcode == Opcode.CHANNEL:
            check_size(record.opcode, len(record.body))
            channel = parse(Channel, record.body)
            if channel.id not in self.channels:
                self._channels_bytes += len(record.body)
                if self._channels_bytes > MAX_CHANNELS_BYTES:
                    raise RecordMalformedError(f"its channels take over {MAX_CHANNELS_BYTES} bytes")
                self.channels[channel.id] = channel

    def add_metadata(self, metadata: Metadata, length: int) -> None:
        """Add one of the metadata records that are read.

        Raises:
            RecordMalformedError: If they take more bytes than those of any log.
        """
        self._metadata_bytes += length
        if self._metadata_bytes > MAX_METADATA_BYTES:
            raise RecordMalformedError(f"they take over {MAX_METADATA_BYTES} bytes together")
        self.metadata.append(metadata)


@dataclass(frozen=True, slots=True)
class ChunkEntry:
    """A chunk index record of the summary; times are limited to a database's integers."""

    offset: int
    length: int
    index_bytes: int
    start_ns: int
    end_ns: int
    counts: dict[int, int] | None


@dataclass(slots=True, eq=False)
class Summary:
    """The records of a summary section, and the end of the data section before it."""

    start: int
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunk_indexes: list[ChunkEntry] = field(default_factory=list)
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
        LogUnusableError: If it names more than any recording has.
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
    # the checksum also covers the footer, up to the checksum itself
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
    """Build a part's index from its summary; metadata may cost one more read."""
    index = PartIndex(number=reader.number)
    index.schemas, index.channels = summary.schemas, summary.channels
    seen: set[int] = set()
    for entry in sorted(summary.chunk_indexes, key=lambda each: each.offset):
        offset, length = entry.offset, entry.length
        if offset in seen:
            continue
        seen.add(offset)
        if offset < len(MAGIC) or length <= HEADER_BYTES or offset + length > summary.start:
            index.damage.append(
                damaged(
                    key=reader.key,
                    offset=min(offset, reader.size),
                    length=0,
                    what="the index names a chunk outside the data of the file",
                )
            )
            continue
        ref = ChunkRef(
            part=reader.number,
            offset=offset,
            length=length,
            start_ns=entry.start_ns,
            end_ns=entry.end_ns,
        )
        index.add_chunk(IndexedChunk(ref=ref, counts=entry.counts))
    if summary.statistics is not None:
        index.message_counts = dict(summary.statistics.channel_message_counts)
    read_metadata(summary, reader, index)
    return index


def read_metadata(summary: Summary, reader: PartReader, index: PartIndex) -> None:
    """Read the metadata records with names in `METADATA_NAMES`, neighbours in one read."""
    by_offset = {
        each.offset: each for each in summary.metadata_indexes if each.name in METADATA_NAMES
    }
    wanted = [by_offset[offset] for offset in sorted(by_offset)]
    if not wanted:
        return
    first, last = wanted[0].offset, max(each.offset + each.length for each in wanted)
    if last <= reader.size and last - first <= MAX_METADATA_SPAN_BYTES:
        reader.read(first, last - first)
    left_bytes = MAX_METADATA_BYTES
    for each in wanted:
        left_bytes -= each.length
        try:
            if left_bytes < 0:
                raise RecordMalformedError(f"they take over {MAX_METADATA_BYTES} bytes together")
            if each.length > MAX_METADATA_SPAN_BYTES:
                raise RecordMalformedError("a metadata record is too large to be one")
            record = _single(reader.read(each.offset, each.length), Opcode.METADATA)
            index.add_metadata(parse(Metadata, record), each.length)
        except RecordMalformedError as error:
            index.damage.append(
                damaged(
                    key=reader.key,
                    offset=min(each.offset, reader.size),
                    length=0,
                    what=f"metadata record {each.name!r} cannot be read: {error.problem}",
                )
            )


def too_many_chunks() -> LogUnusableError:
    """Build the error of a recording with more chunks than planning can hold."""
    return LogUnusableError(
        f"the recording has more than {MAX_CHUNKS} chunks: write larger chunks, or split it"
    )


def check_size(opcode: int, length: int) -> None:
    """Refuse a record that is larger than any of its kind.

    Raises:
        RecordMalformedError: If it is; parsing it could take a hundred times its bytes.
    """
    large = opcode in (Opcode.SCHEMA, Opcode.METADATA)
    if length > (MAX_SCHEMA_BYTES if large else MAX_SMALL_BYTES):
        raise RecordMalformedError("a record of this kind is never so large")


def _summary(start: int, section: memoryview) -> Summary:
    summary = Summary(start=start)
    described = PartIndex(number=0)
    counted = 0
    for number, record in enumerate(walk(section)):
        if number == MAX_SUMMARY_RECORDS:
            raise LogUnusableError(
                f"the summary has more than {MAX_SUMMARY_RECORDS} records: split the recording"
            )
        check_size(record.opcode, len(record.body))
        match record.opcode:
            case Opcode.SCHEMA | Opcode.CHANNEL:
                described.add_record(record)
            case Opcode.CHUNK_INDEX:
                entry = _chunk_entry(parse(ChunkIndex, record.body))
                counted += len(entry.counts or ())
                if len(summary.chunk_indexes) >= MAX_CHUNKS or counted > MAX_COUNTED:
                    raise too_many_chunks()
                summary.chunk_indexes.append(entry)
            case Opcode.ATTACHMENT_INDEX:
                summary.attachment_indexes.append(parse(AttachmentIndex, record.body))
            case Opcode.METADATA_INDEX:
                summary.metadata_indexes.append(parse(MetadataIndex, record.body))
            case Opcode.STATISTICS:
                summary.statistics = parse(Statistics, record.body)
            case _:
                pass
    summary.schemas, summary.channels = described.schemas, described.channels
    return summary


def _chunk_entry(entry: ChunkIndex) -> ChunkEntry:
    start, end = sorted((entry.message_start_time, entry.message_end_time))
    return ChunkEntry(
        offset=entry.chunk_start_offset,
        length=entry.chunk_length,
        index_bytes=entry.message_index_length,
        start_ns=min(start, MAX_INTEGER),
        end_ns=min(end, MAX_INTEGER),
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
