"""MCAP records as bytes: iteration, and parsing of the small ones with exact lengths.

Message payloads and chunks are never copied here; the record classes of the `mcap` library read
the small records (schemas, channels, indexes), over a stream that refuses to end early.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Final, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

MAGIC: Final = b"\x89MCAP0\r\n"
HEADER_BYTES: Final = 9
"""Opcode and length, in front of every record."""
FOOTER_BYTES: Final = HEADER_BYTES + 20
CHUNK_FIELDS_BYTES: Final = 40
"""Bytes of a Chunk record's fields before its records, without the name of its compression."""
MESSAGE_FIELDS_BYTES: Final = 22

_HEADER: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")
_CHUNK: Final = struct.Struct("<QQQII")


class RecordMalformedError(ValueError):
    """A record's bytes are invalid; offsets count from the start of the view."""

    def __init__(self, problem: str, *, offset: int = 0) -> None:
        """Keep its offset."""
        super().__init__(problem)
        self.problem, self.offset = problem, offset


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """One record, its content not parsed.

    Attributes:
        opcode: What kind of record.
        offset: Its first byte in the walked view.
        body: Its content, without opcode and length.
    """

    opcode: int
    offset: int
    body: memoryview

    @property
    def end(self) -> int:
        """Return the end in the walked view."""
        return self.offset + HEADER_BYTES + len(self.body)


@dataclass(frozen=True, slots=True)
class ChunkHeader:
    """Fields of a Chunk record before its compressed records."""

    start_ns: int
    end_ns: int
    uncompressed_bytes: int
    uncompressed_crc: int
    compression: str
    records_offset: int
    records_bytes: int


Small = TypeVar("Small")


class _ExactStream(BytesIO):
    """A stream that refuses a short read, which the library would accept."""

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(size)
        if size is not None and len(data) < size:
            raise RecordMalformedError("a field reaches beyond its record")
        return data


def record_header(view: memoryview, offset: int) -> tuple[int, int]:
    """Read opcode and content length of the record at an offset."""
    opcode, length = _HEADER.unpack_from(view, offset)
    return opcode, length


def walk(view: memoryview) -> Iterator[Record]:
    """Yield the consecutive records in these bytes.

    Raises:
        RecordMalformedError: At the first one that reaches beyond the end.
    """
    offset, end = 0, len(view)
    while offset < end:
        if offset + HEADER_BYTES > end:
            raise RecordMalformedError("a record is cut in its header", offset=offset)
        opcode, length = record_header(view, offset)
        body = offset + HEADER_BYTES
        if length > end - body:
            raise RecordMalformedError("a record reaches beyond the end", offset=offset)
        yield Record(opcode, offset, view[body : body + length])
        offset = body + length


def count_records(view: memoryview, *, most: int) -> int:
    """Count the consecutive records in these bytes, up to a maximum."""
    offset, end, number = 0, len(view) - HEADER_BYTES, 0
    while offset <= end and number < most:
        offset += HEADER_BYTES + _HEADER.unpack_from(view, offset)[1]
        number += 1
    return number


def parse(kind: type[Small], body: memoryview) -> Small:
    """Read a small record with its class of the `mcap` library.

    Raises:
        RecordMalformedError: If the bytes are no such record.
    """
    try:
        return kind.read(ReadDataStream(_ExactStream(bytes(body))))  # type: ignore[attr-defined, no-any-return]
    except (McapError, struct.error, ValueError, OverflowError) as error:
        raise RecordMalformedError(f"no {kind.__name__} record: {error}") from None


def message_fields(body: memoryview) -> tuple[int, int]:
    """Read channel id and log time of a Message record.

    Raises:
        RecordMalformedError: If it is too short to be one.
    """
    if len(body) < MESSAGE_FIELDS_BYTES:
        raise RecordMalformedError("a message is shorter than its own fields")
    channel_id, _, log_time_ns, _ = _MESSAGE.unpack_from(body)
    return channel_id, log_time_ns


def message_index_fields(body: memoryview) -> tuple[int, int]:
    """Read channel id and number of messages of a MessageIndex record."""
    if len(body) < 6:
        raise RecordMalformedError("a message index is shorter than its own fields")
    channel_id, entries_bytes = struct.unpack_from("<HI", body)
    return channel_id, entries_bytes // 16


def chunk_header(body: memoryview) -> ChunkHeader:
    """Read the header fields of a Chunk record; its compressed records need not be there.

    Raises:
        RecordMalformedError: If it is too short or its compression has no name.
    """
    if len(body) < CHUNK_FIELDS_BYTES:
        raise RecordMalformedError("a chunk is shorter than its own fields")
    start_ns, end_ns, size, crc, name_bytes = _CHUNK.unpack_from(body)
    records_offset = CHUNK_FIELDS_BYTES + name_bytes
    if name_bytes > 64 or len(body) < records_offset:
        raise RecordMalformedError("a chunk names no compression")
    name = body[_CHUNK.size : _CHUNK.size + name_bytes].tobytes()
    (records_bytes,) = struct.unpack_from("<Q", body, _CHUNK.size + name_bytes)
    return ChunkHeader(
        start_ns=start_ns,
        end_ns=end_ns,
        uncompressed_bytes=size,
        uncompressed_crc=crc,
        compression=name.decode("ascii", "replace"),
        records_offset=records_offset,
        records_bytes=records_bytes,
    )
