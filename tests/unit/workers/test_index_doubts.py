"""A chunk index that contradicts itself, or the bytes: nothing is lost that a scan would find."""

import struct
from collections.abc import Callable
from dataclasses import replace

import pytest
from mcap.writer import CompressionType, IndexType

from schemas.transport.bucket import Bucket, open_bucket
from tests.tiny_logs import Recorder, drive, only_recording
from workers.ingest import footer as footer_module
from workers.ingest.chunk import messages_in
from workers.ingest.log_index import LogIndex, index_recording

RECORDER = Recorder(chunk_bytes=30_000, compression=CompressionType.NONE)
MESSAGES = 30
START, LENGTH, INDEX_BYTES = 16, 24, 36
"""Places of the fields in a ChunkIndex record; the last one counts from the end of its map."""


def bucket_of(data: bytes) -> Bucket:
    bucket = open_bucket("memory://")
    bucket.put("drive_0.mcap", data)
    return bucket


def indexed(data: bytes) -> LogIndex:
    bucket = bucket_of(data)
    return index_recording(bucket, only_recording(bucket))


def readable(index: LogIndex) -> int:
    """Messages in all chunks of the index, each chunk opened."""
    (part,) = index.parts
    return sum(1 for chunk in part.chunks for _ in messages_in(index.open(chunk.ref)))


class Log:
    """A log whose chunk index can be changed; no checksum guards its summary any more."""

    def __init__(self, recorder: Recorder = RECORDER) -> None:
        self.data = bytearray(recorder.write(drive(3)))
        struct.pack_into("<I", self.data, len(self.data) - 12, 0)
        (offset,) = struct.unpack_from("<Q", self.data, len(self.data) - 28)
        self.entries: list[int] = []
        while offset < len(self.data) - 37:
            opcode, length = struct.unpack_from("<BQ", self.data, offset)
            if opcode == 8:
                self.entries.append(offset + 9)
            offset += 9 + length

    def get(self, entry: int, field: int) -> int:
        at = self.entries[entry]
        if field == INDEX_BYTES:
            at += struct.unpack_from("<I", self.data, at + 32)[0]
        return int(struct.unpack_from("<Q", self.data, at + field)[0])

    def put(self, entry: int, field: int, value: int) -> None:
        at = self.entries[entry]
        if field == INDEX_BYTES:
            at += struct.unpack_from("<I", self.data, at + 32)[0]
        struct.pack_into("<Q", self.data, at + field, value)

    def add(self, entry: int, field: int, value: int) -> None:
        self.put(entry, field, self.get(entry, field) + value)

    def repeat(self, entry: int) -> None:
        """Replace the record after this one, which has the same length, by a copy of it."""
        at, after = self.entries[entry], self.entries[entry + 1]
        self.data[after : 2 * after - at] = self.data[at:after]


def covers_the_next(log: Log) -> None:
    log.put(2, LENGTH, log.get(3, START) + log.get(3, LENGTH) - log.get(2, START))


def reaches_into_the_next(log: Log) -> None:
    log.add(2, LENGTH, 1000)


def ends_too_early(log: Log) -> None:
    log.add(2, LENGTH, -1000)


def ends_too_early_by_whole_entries(log: Log) -> None:
    log.add(2, LENGTH, -1600)


def begins_within_another(log: Log) -> None:
    log.add(3, START, -500)


def begins_too_late(log: Log) -> None:
    log.add(0, START, 7)


def begins_too_early(log: Log) -> None:
    log.add(0, START, -5)


def is_named_twice_and_one_lies(log: Log) -> None:
    log.put(3, START, log.get(2, START))
    log.put(3, LENGTH, log.get(2, LENGTH) - 64)


def reaches_into_the_end_of_the_data(log: Log) -> None:
    log.add(len(log.entries) - 1, LENGTH, 11)


LIES = [
    covers_the_next,
    reaches_into_the_next,
    ends_too_early,
    ends_too_early_by_whole_entries,
    begins_within_another,
    begins_too_late,
    begins_too_early,
    is_named_twice_and_one_lies,
    reaches_into_the_end_of_the_data,
]


@pytest.mark.parametrize(
    "tail_bytes", [pytest.param(64, id="far"), pytest.param(1 << 20, id="held")]
)
@pytest.mark.parametrize("statistics", [True, False])
@pytest.mark.parametrize("lie", LIES, ids=lambda lie: lie.__name__)
def test_nothing_is_lost_that_a_scan_would_find(
    lie: Callable[[Log], None],
    statistics: bool,
    tail_bytes: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(footer_module, "TAIL_BYTES", tail_bytes)
    log = Log(replace(RECORDER, statistics=statistics))
    lie(log)
    index = indexed(bytes(log.data))
    assert readable(index) == MESSAGES
    (note,) = index.damage
    assert "the index is wrong about" in note.what
    assert note.bytes == 0


@pytest.mark.parametrize(
    "recorder",
    [
        pytest.param(RECORDER, id="whole"),
        pytest.param(replace(RECORDER, compression=CompressionType.ZSTD), id="zstd"),
        pytest.param(replace(RECORDER, metadata={"other": {"a": "b"}}), id="metadata"),
        pytest.param(replace(RECORDER, repeat_channels=False), id="no channels in the summary"),
    ],
)
def test_a_good_log_is_read_by_its_index_alone(
    recorder: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(footer_module, "TAIL_BYTES", 64)
    index = indexed(recorder.write(drive(3)))
    assert not list(index.damage)
    assert not index.parts[0].recovered
    least = 2 if recorder.repeat_channels else 3
    assert index.range_reads <= least
    assert readable(index) == MESSAGES


def test_of_equal_records_one_counts_and_the_chunk_that_lost_its_own_is_found() -> None:
    log = Log()
    log.repeat(2)
    index = indexed(bytes(log.data))
    assert readable(index) == MESSAGES
    assert not list(index.damage)


def test_without_message_indexes_a_chunk_that_covers_the_next_is_found_too() -> None:
    log = Log(replace(RECORDER, indexes=IndexType.CHUNK))
    covers_the_next(log)
    assert readable(indexed(bytes(log.data))) == MESSAGES
