"""MCAP chunks: opened after every field of their header is checked."""

import zlib
from collections.abc import Container, Iterator
from dataclasses import dataclass

import lz4.frame
import zstandard
from mcap.opcode import Opcode

from schemas.work import ChunkRef
from workers.errors import ChunkUnreadableError
from workers.ingest.limits import MAX_CHUNK_BYTES, MAX_CHUNK_RECORDS
from workers.ingest.records import (
    HEADER_BYTES,
    MESSAGE_FIELDS_BYTES,
    ChunkHeader,
    RecordMalformedError,
    chunk_header,
    message_fields,
    record_header,
    walk,
)


@dataclass(frozen=True, slots=True, eq=False)
class StoredMessage:
    """A message in a chunk.

    Attributes:
        channel_id: Its channel, in the numbers of its part.
        log_time_ns: Its log time.
        data: Its payload, a view into the opened chunk.
        offset: First byte of the payload in the opened chunk.
    """

    channel_id: int
    log_time_ns: int
    data: memoryview
    offset: int


def open_chunk(data: bytes | memoryview, ref: ChunkRef, *, key: str) -> memoryview:
    """Check and decompress the bytes of a reference.

    Args:
        data: Exactly the bytes that the reference names.
        ref: A Chunk record, or a run of records outside chunks, which is returned unchanged.
        key: Their object, for the error.

    Returns:
        The records inside, one after the other.

    Raises:
        ChunkUnreadableError: If any of it is invalid.
    """
    view = memoryview(data)
    if ref.kind == "records":
        return view
    try:
        return _open(view)
    except RecordMalformedError as error:
        problem = error.problem
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
        problem = f"decompression fails ({error})"
    raise ChunkUnreadableError(key=key, offset=ref.offset, length=ref.length, problem=problem)


def opened_bytes(data: bytes | memoryview, ref: ChunkRef) -> int:
    """Read the uncompressed size in a chunk's header; the stored size where there is none."""
    body = memoryview(data)[HEADER_BYTES:]
    if ref.kind == "records":
        return len(data)
    try:
        return chunk_header(body).uncompressed_bytes
    except RecordMalformedError:
        return len(data)


def too_large(ref: ChunkRef, *, key: str) -> ChunkUnreadableError | None:
    """Return the error of a reference to more bytes than any chunk has, which is not read."""
    if ref.length <= MAX_CHUNK_BYTES:
        return None
    problem = f"it takes {ref.length} bytes, more than the {MAX_CHUNK_BYTES} allowed"
    return ChunkUnreadableError(key=key, offset=ref.offset, length=ref.length, problem=problem)


def messages_in(
    records: memoryview, channel_ids: Container[int] | None = None
) -> Iterator[StoredMessage]:
    """Yield the messages of an opened chunk, in the order they were written.

    Args:
        records: Records from `open_chunk`.
        channel_ids: Only these channels; None for all.

    Raises:
        RecordMalformedError: At the first invalid record; those before it are valid.
    """
    for number, record in enumerate(walk(records)):
        if number == MAX_CHUNK_RECORDS:
            raise RecordMalformedError(
                f"it holds more than {MAX_CHUNK_RECORDS} records, and the rest is not read",
                offset=record.offset,
            )
        if record.opcode != Opcode.MESSAGE:
            continue
        try:
            channel_id, log_time_ns = message_fields(record.body)
        except RecordMalformedError as error:
            raise RecordMalformedError(error.problem, offset=record.offset) from None
        if channel_ids is None or channel_id in channel_ids:
            at = record.offset + HEADER_BYTES + MESSAGE_FIELDS_BYTES
            yield StoredMessage(channel_id, log_time_ns, records[at : record.end], at)


def _open(view: memoryview) -> memoryview:
    if len(view) < HEADER_BYTES:
        raise RecordMalformedError("it is cut in its header")
    opcode, length = record_header(view, 0)
    if opcode != Opcode.CHUNK or length != len(view) - HEADER_BYTES:
        raise RecordMalformedError("there is no chunk of this length where the index says")
    body = view[HEADER_BYTES:]
    header = chunk_header(body)
    if header.records_bytes != len(body) - header.records_offset:
        raise RecordMalformedError("its records do not fill it")
    if header.uncompressed_bytes > MAX_CHUNK_BYTES:
        raise RecordMalformedError(
            f"it says that it grows to {header.uncompressed_bytes} bytes, "
            f"more than the {MAX_CHUNK_BYTES} allowed"
        )
    records = _decompress(body[header.records_offset :], header)
    if len(records) != header.uncompressed_bytes:
        raise RecordMalformedError(
            f"it does not grow to the {header.uncompressed_bytes} bytes it says"
        )
    if header.uncompressed_crc and zlib.crc32(records) != header.uncompressed_crc:
        raise RecordMalformedError("its checksum is wrong")
    return records


def _decompress(packed: memoryview, header: ChunkHeader) -> memoryview:
    match header.compression:
        case "":
            return packed
        case "zstd":
            return _unpack_zstd(packed, header.uncompressed_bytes)
        case "lz4":
            return _unpack_lz4(packed, header.uncompressed_bytes)
        case unknown:
            raise RecordMalformedError(f"its compression is unknown: {unknown!r}")


def _unpack_zstd(packed: memoryview, expected: int) -> memoryview:
    size = zstandard.frame_content_size(packed) if len(packed) else 0
    if size > expected:
        raise RecordMalformedError(f"it would grow to {size} bytes and says {expected}")
    if size == expected:
        return memoryview(zstandard.ZstdDecompressor().decompress(packed))
    # of unknown size, or of several frames: it grows in steps, at most one byte too far
    with zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as reader:
        return memoryview(_read_at_most(reader, expected + 1))


def _read_at_most(reader: zstandard.ZstdDecompressionReader, limit: int) -> bytes:
    pieces: list[bytes] = []
    total = 0
    while total < limit:
        piece = reader.read(min(limit - total, 1024 * 1024))
        if not piece:
            break
        pieces.append(piece)
        total += len(piece)
    return b"".join(pieces)


def _unpack_lz4(packed: memoryview, expected: int) -> memoryview:
    unpacker = lz4.frame.LZ4FrameDecompressor()
    records = unpacker.decompress(packed, max_length=max(expected, 1))
    if not unpacker.eof:
        # an end mark may follow the last byte; any further byte is too much
        if unpacker.decompress(b"", max_length=1):
            raise RecordMalformedError(f"it grows beyond the {expected} bytes it says")
        if not unpacker.eof:
            raise RecordMalformedError("its compressed records are cut")
    return memoryview(records)
