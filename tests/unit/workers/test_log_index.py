"""A log's index: few reads where the summary is whole, and everything readable where it is not."""

import struct
from dataclasses import replace

import pytest
from mcap.writer import CompressionType, IndexType

from schemas.errors import ObjectChangedError
from schemas.transport.bucket import Bucket, open_bucket
from tests.tiny_logs import BEGIN_NS, LIDAR, Recorder, Said, drive, only_recording, ring
from workers.errors import NotMcapError
from workers.ingest import footer as footer_module
from workers.ingest.chunk import messages_in
from workers.ingest.index import IndexedChunk
from workers.ingest.log_index import LogIndex, index_recording
from workers.ingest.topics import topics_of

SMALL_CHUNKS = Recorder(chunk_bytes=30_000)
NO_SUMMARY = Recorder(
    chunk_bytes=30_000,
    statistics=False,
    summary_offsets=False,
    repeat_channels=False,
    repeat_schemas=False,
    indexes=IndexType.MESSAGE,
)
END_OF_FILE = bytes(13 + 29 + 8)
"""As long as DataEnd, footer and magic are."""
LOOSE = replace(NO_SUMMARY, chunked=False)


def bucket_with(*parts: bytes) -> Bucket:
    bucket = open_bucket("memory://")
    for number, part in enumerate(parts):
        bucket.put(f"drive_{number}.mcap", part)
    return bucket


def indexed(*parts: bytes) -> LogIndex:
    bucket = bucket_with(*parts)
    return index_recording(bucket, only_recording(bucket))


def chunks_in(index: LogIndex) -> list[IndexedChunk]:
    return [chunk for part in index.parts for chunk in part.chunks]


def messages_in_index(index: LogIndex) -> int:
    """Messages of the lidar; every one of them must have been found."""
    (topic,) = topics_of(index.parts)
    assert topic.channel.topic == LIDAR
    assert topic.channel.schema_name == "sensor_msgs/msg/PointCloud2"
    return topic.messages


def small_tail(monkeypatch: pytest.MonkeyPatch, size: int = 4096) -> None:
    monkeypatch.setattr(footer_module, "TAIL_BYTES", size)


def test_an_intact_log_is_indexed_in_one_read() -> None:
    index = indexed(SMALL_CHUNKS.write(drive(5)))
    assert index.range_reads == 1
    assert messages_in_index(index) == 50
    assert not list(index.damage)
    assert [chunk.counts for chunk in chunks_in(index)[:2]] == [{1: 3}, {1: 3}]


def test_a_summary_longer_than_the_tail_and_metadata_far_away_cost_three_reads(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    small_tail(monkeypatch, 64)
    recorder = replace(
        SMALL_CHUNKS,
        metadata={
            "counterpoint.log": {"vehicle": "car-7"},
            "counterpoint.classes": {"1": "{}"},
            "other": {"x": "y"},
        },
    )
    index = indexed(recorder.write(drive(10)))
    assert index.range_reads == 3
    assert index.metadata("counterpoint.log") == [{"vehicle": "car-7"}]
    assert index.metadata("counterpoint.classes") == [{"1": "{}"}]
    assert index.metadata("other") == []
    assert messages_in_index(index) == 100


def test_the_channels_of_all_parts_are_one_topic() -> None:
    first = drive(2)
    second = [Said("/other", said.log_time_ns, said.data) for said in first[:3]] + first
    index = indexed(SMALL_CHUNKS.write(first), SMALL_CHUNKS.write(second))
    by_name = {topic.channel.topic: topic for topic in topics_of(index.parts)}
    assert by_name[LIDAR].messages == 40
    assert by_name[LIDAR].channel.ids == ((0, 1), (1, 2))
    assert by_name["/other"].channel.ids == ((1, 1),)


@pytest.mark.parametrize(
    "recorder",
    [
        pytest.param(replace(SMALL_CHUNKS, indexes=IndexType.NONE), id="no index"),
        pytest.param(
            replace(SMALL_CHUNKS, repeat_channels=False, repeat_schemas=False), id="no channels"
        ),
        pytest.param(replace(SMALL_CHUNKS, repeat_schemas=False), id="no schemas"),
        pytest.param(replace(SMALL_CHUNKS, statistics=False), id="no statistics"),
        pytest.param(replace(SMALL_CHUNKS, indexes=IndexType.CHUNK), id="no message index"),
        pytest.param(NO_SUMMARY, id="no summary"),
        pytest.param(replace(NO_SUMMARY, indexes=IndexType.NONE), id="nothing but chunks"),
        pytest.param(LOOSE, id="nothing but messages"),
        pytest.param(replace(SMALL_CHUNKS, chunked=False), id="no chunks"),
        pytest.param(replace(SMALL_CHUNKS, compression=CompressionType.NONE), id="uncompressed"),
    ],
)
@pytest.mark.parametrize("tail", [64, 1 << 20])
def test_every_message_is_found_whatever_the_writer_left_out(
    recorder: Recorder, tail: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    small_tail(monkeypatch, tail)
    index = indexed(recorder.write(drive(3)))
    assert messages_in_index(index) == 30
    opened = [index.open(chunk.ref) for chunk in chunks_in(index)]
    assert sum(1 for records in opened for _ in messages_in(records)) == 30
    assert not list(index.damage)


def test_a_log_without_a_summary_is_hopped_over_not_read() -> None:
    pause_bytes = 3_000_000
    messages = [
        Said(LIDAR, BEGIN_NS + number * 10**8, ring(BEGIN_NS) + bytes(pause_bytes))
        for number in range(10)
    ]
    data = replace(NO_SUMMARY, compression=CompressionType.NONE, chunk_bytes=10).write(messages)
    index = indexed(data)
    assert len(chunks_in(index)) == 10
    # The tail, a step for each chunk, and the one chunk that names the channel.
    assert index.bytes_read < 10 * 200_000 + 2 * pause_bytes


def test_messages_outside_chunks_are_found_beside_chunks_that_are_indexed() -> None:
    whole = replace(SMALL_CHUNKS, statistics=False).write(drive(3))
    loose = struct.pack("<BQHIQQ", 5, 22 + 90_000, 1, 0, BEGIN_NS, BEGIN_NS) + bytes(90_000)
    (first, *_) = chunks_in(indexed(whole))
    index = indexed(moved(whole, at=first.ref.offset, by=loose))
    kinds = [chunk.ref.kind for chunk in chunks_in(index)]
    assert kinds.count("records") == 1
    assert kinds.count("chunk") == len(kinds) - 1
    (found,) = (chunk for chunk in chunks_in(index) if chunk.ref.kind == "records")
    assert (found.ref.offset, found.ref.length) == (first.ref.offset, len(loose))
    assert found.ref.start_ns == BEGIN_NS


def moved(data: bytes, *, at: int, by: bytes) -> bytes:
    """Insert bytes, and move what the chunk indexes and the footer point to."""
    footer = len(data) - 8 - 20
    (summary_start,) = struct.unpack_from("<Q", data, footer)
    out = bytearray(data[:at] + by + data[at:])
    struct.pack_into("<QQI", out, footer + len(by), summary_start + len(by), 0, 0)
    offset = summary_start + len(by)
    while offset < footer + len(by) - 9:
        opcode, length = struct.unpack_from("<BQ", out, offset)
        if opcode == 8:
            (start,) = struct.unpack_from("<Q", out, offset + 9 + 16)
            struct.pack_into("<Q", out, offset + 9 + 16, start + len(by))
            (map_bytes,) = struct.unpack_from("<I", out, offset + 9 + 32)
            for entry in range(offset + 9 + 36, offset + 9 + 36 + map_bytes, 10):
                (place,) = struct.unpack_from("<Q", out, entry + 2)
                struct.pack_into("<Q", out, entry + 2, place + len(by))
        offset += 9 + length
    return bytes(out)


@pytest.mark.parametrize("recorder", [SMALL_CHUNKS, NO_SUMMARY, LOOSE])
def test_a_file_that_was_cut_gives_what_lies_before_the_cut(recorder: Recorder) -> None:
    data = recorder.write(drive(3))
    index = indexed(data[: len(data) * 6 // 10])
    assert 14 <= messages_in_index(index) <= 18
    cut, unclosed = list(index.damage)
    assert cut.what == "the file ends inside a record"
    assert cut.offset + cut.bytes == len(data) * 6 // 10
    assert "never closed" in unclosed.what


def test_a_preallocated_tail_of_zeros_is_damage_not_a_hang() -> None:
    data = NO_SUMMARY.write(drive(2))
    index = indexed(data[: -len(END_OF_FILE)] + bytes(3_000_000))
    assert messages_in_index(index) == 20
    assert [(damage.bytes, damage.what) for damage in index.damage] == [
        (3_000_000, "bytes that are no record"),
        (0, "the file was never closed: it has no end mark"),
    ]


@pytest.mark.parametrize("recorder", [NO_SUMMARY, LOOSE])
def test_after_a_record_whose_length_is_wrong_the_search_goes_on(recorder: Recorder) -> None:
    data = bytearray(recorder.write(drive(3)))
    victim = chunks_in(indexed(bytes(data)))[0].ref
    at = victim.offset
    struct.pack_into("<Q", data, at + 1, 1 << 60)
    index = indexed(bytes(data))
    assert [damage.offset for damage in index.damage][:1] == [at]
    assert all(chunk.ref.offset > at for chunk in chunks_in(index))
    assert messages_in_index_or_nameless(index) >= 26


def messages_in_index_or_nameless(index: LogIndex) -> int:
    return sum(sum((chunk.counts or {}).values()) for chunk in chunks_in(index))


def test_a_summary_whose_checksum_is_wrong_is_not_believed() -> None:
    data = bytearray(SMALL_CHUNKS.write(drive(2)))
    data[-60] ^= 1
    index = indexed(bytes(data))
    assert messages_in_index(index) == 20
    assert index.parts[0].recovered
    assert any("checksum is wrong" in damage.what for damage in index.damage)


def test_a_footer_that_points_nowhere_is_not_believed() -> None:
    data = bytearray(SMALL_CHUNKS.write(drive(2)))
    struct.pack_into("<QQI", data, len(data) - 28, 1 << 50, 0, 0)
    index = indexed(bytes(data))
    assert messages_in_index(index) == 20
    assert any("outside the file" in damage.what for damage in index.damage)


@pytest.mark.parametrize("field", [pytest.param(16, id="offset"), pytest.param(24, id="length")])
def test_an_index_entry_that_points_outside_the_data_is_damage(field: int) -> None:
    data = bytearray(SMALL_CHUNKS.write(drive(2)))
    struct.pack_into("<I", data, len(data) - 12, 0)
    (summary_start,) = struct.unpack_from("<Q", data, len(data) - 28)
    offset = summary_start
    while data[offset] != 8:
        offset += 9 + struct.unpack_from("<Q", data, offset + 1)[0]
    struct.pack_into("<Q", data, offset + 9 + field, 1 << 40)
    index = indexed(bytes(data))
    assert [damage.what for damage in index.damage] == [
        "the index names a chunk outside the data of the file"
    ]
    # The chunk itself is whole: it is found where no index entry explains the bytes.
    assert messages_in_index_or_nameless(index) == 20


@pytest.mark.parametrize(
    ("data", "says"),
    [
        pytest.param(b"", "is empty", id="empty"),
        pytest.param(b"#ROSBAG V2.0\n" + bytes(100), "no MCAP file", id="a bag"),
        pytest.param(b"\x28\xb5\x2f\xfd" + bytes(100), "compressed as a whole", id="zstd"),
        pytest.param(b"\x1f\x8b" + bytes(100), "compressed as a whole", id="gzip"),
        pytest.param(b"\x89MCAP9\r\n" + bytes(50), "version", id="another version"),
        pytest.param(b"\x89MC", "no MCAP file", id="three bytes"),
    ],
)
def test_what_is_no_mcap_file_is_refused_in_words(data: bytes, says: str) -> None:
    with pytest.raises(NotMcapError, match=rf"{says}.*\(memory:.*/drive_0\.mcap\)"):
        indexed(data)


def test_a_log_that_is_replaced_while_it_is_indexed_is_not_mixed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    small_tail(monkeypatch)
    bucket = bucket_with(SMALL_CHUNKS.write(drive(10)))
    recording = only_recording(bucket)
    bucket.put("drive_0.mcap", SMALL_CHUNKS.write(drive(11)))
    with pytest.raises(ObjectChangedError, match=r"drive_0\.mcap"):
        index_recording(bucket, recording)
