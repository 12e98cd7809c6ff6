"""A chunk is read only if all it says of itself is true, and never grows beyond what it says."""

import struct
import tracemalloc
import zlib
from collections.abc import Callable

import lz4.frame
import pytest
import zstandard

from schemas.work import ChunkRef
from workers.errors import ChunkUnreadableError
from workers.ingest.chunk import messages_in, open_chunk
from workers.ingest.records import RecordMalformedError

RECORDS = b"".join(
    struct.pack("<BQHIQQ", 5, 22 + len(data), channel_id, 0, time_ns, time_ns) + data
    for channel_id, time_ns, data in ((1, 10, b"one"), (2, 20, b""), (1, 30, b"three" * 100))
)
MIB = 1024 * 1024


def several_zstd_frames(data: bytes) -> bytes:
    return b"".join(zstandard.compress(half) for half in (data[:100], data[100:]))


def zstd_without_size(data: bytes) -> bytes:
    return zstandard.ZstdCompressor(write_content_size=False).compress(data)


def as_is(data: bytes) -> bytes:
    return data


def chunk(
    records: bytes,
    *,
    compression: str = "",
    size: int | None = None,
    crc: int | None = None,
    packed: bytes | None = None,
) -> bytes:
    """Write a Chunk record; size and checksum may be made to lie."""
    inside = records if packed is None else packed
    body = struct.pack(
        "<QQQII",
        10,
        30,
        len(records) if size is None else size,
        zlib.crc32(records) if crc is None else crc,
        len(compression),
    )
    body += compression.encode() + struct.pack("<Q", len(inside)) + inside
    return struct.pack("<BQ", 6, len(body)) + body


def opened(data: bytes) -> memoryview:
    ref = ChunkRef(part=0, offset=500, length=len(data), start_ns=10, end_ns=30)
    return open_chunk(data, ref, key="car/log.mcap")


def refused(data: bytes) -> str:
    with pytest.raises(ChunkUnreadableError, match=r"car/log\.mcap at byte 500") as caught:
        opened(data)
    assert (caught.value.offset, caught.value.length) == (500, len(data))
    return caught.value.problem


@pytest.mark.parametrize(
    ("compression", "pack"),
    [
        pytest.param("", as_is, id="none"),
        pytest.param("zstd", zstandard.compress, id="zstd"),
        pytest.param("zstd", zstd_without_size, id="zstd of unknown size"),
        pytest.param("zstd", several_zstd_frames, id="zstd in several frames"),
        pytest.param("lz4", lz4.frame.compress, id="lz4"),
    ],
)
def test_records_come_back_as_they_were_written(
    compression: str, pack: Callable[[bytes], bytes]
) -> None:
    for records in (RECORDS, b""):
        assert opened(chunk(records, compression=compression, packed=pack(records))) == records


def test_a_checksum_of_zero_says_nothing() -> None:
    assert opened(chunk(RECORDS, crc=0)) == RECORDS


def test_a_flipped_bit_is_found_by_the_checksum() -> None:
    data = bytearray(chunk(RECORDS))
    data[-1] ^= 1
    assert refused(bytes(data)) == "its checksum is wrong"


@pytest.mark.parametrize("size", [0, len(RECORDS) - 1, len(RECORDS) + 1])
@pytest.mark.parametrize(
    ("compression", "pack"),
    [
        pytest.param("", as_is, id="none"),
        pytest.param("zstd", zstandard.compress, id="zstd"),
        pytest.param("zstd", zstd_without_size, id="zstd of unknown size"),
        pytest.param("lz4", lz4.frame.compress, id="lz4"),
    ],
)
def test_a_size_that_lies_is_refused(
    compression: str, pack: Callable[[bytes], bytes], size: int
) -> None:
    data = chunk(RECORDS, compression=compression, packed=pack(RECORDS), size=size, crc=0)
    assert "say" in refused(data) or "cut" in refused(data)


@pytest.mark.parametrize(
    ("compression", "pack"),
    [
        pytest.param("zstd", zstandard.compress, id="zstd"),
        pytest.param("zstd", zstd_without_size, id="zstd of unknown size"),
        pytest.param("lz4", lz4.frame.compress, id="lz4"),
    ],
)
def test_a_bomb_is_refused_before_it_grows(
    compression: str, pack: Callable[[bytes], bytes]
) -> None:
    data = chunk(b"", compression=compression, packed=pack(bytes(64 * MIB)), size=4096, crc=0)
    tracemalloc.start()
    try:
        refused(data)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 8 * MIB


def test_a_chunk_that_says_it_is_enormous_is_refused() -> None:
    assert "more than" in refused(chunk(RECORDS, size=1 << 40))


@pytest.mark.parametrize(
    ("data", "says"),
    [
        pytest.param(b"\x06", "cut in its header", id="nothing there"),
        pytest.param(chunk(RECORDS)[:-1], "no chunk of this length", id="cut"),
        pytest.param(b"\x05" + chunk(RECORDS)[1:], "no chunk", id="another record"),
        pytest.param(chunk(RECORDS, compression="brotli"), "unknown: 'brotli'", id="compression"),
        pytest.param(chunk(RECORDS, compression="zstd"), "decompression fails", id="no zstd"),
        pytest.param(chunk(RECORDS, compression="lz4"), "decompression fails", id="no lz4"),
        pytest.param(struct.pack("<BQ", 6, 20) + bytes(20), "shorter", id="no fields"),
        pytest.param(
            struct.pack("<BQQQQII", 6, 50, 0, 0, 0, 0, 1 << 31) + bytes(18), "names no", id="name"
        ),
    ],
)
def test_what_is_no_chunk_is_refused(data: bytes, says: str) -> None:
    assert says in refused(data)


def test_records_outside_chunks_are_taken_as_they_are() -> None:
    ref = ChunkRef(kind="records", part=0, offset=8, length=len(RECORDS), start_ns=0, end_ns=0)
    assert open_chunk(RECORDS, ref, key="x") == RECORDS


def test_messages_of_the_channels_wanted_are_given() -> None:
    wanted = list(messages_in(memoryview(RECORDS), {1}))
    assert [(each.log_time_ns, bytes(each.data)) for each in wanted] == [
        (10, b"one"),
        (30, b"three" * 100),
    ]
    assert len(list(messages_in(memoryview(RECORDS)))) == 3


@pytest.mark.parametrize(
    "rest",
    [
        pytest.param(struct.pack("<BQ", 5, 1000) + b"short", id="reaches beyond the end"),
        pytest.param(struct.pack("<BQ", 5, 21) + bytes(21), id="shorter than its fields"),
        pytest.param(b"\x05\x01", id="cut in its header"),
    ],
)
def test_messages_before_a_broken_record_are_given(rest: bytes) -> None:
    found = messages_in(memoryview(RECORDS + rest))
    assert [next(found).log_time_ns for _ in range(3)] == [10, 20, 30]
    with pytest.raises(RecordMalformedError) as caught:
        next(found)
    assert caught.value.offset == len(RECORDS)
