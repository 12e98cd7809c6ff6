"""Index recovery: rebuilds a part's index without its summary, from record headers.

Every complete record of the file is found: chunks, and runs of messages outside chunks. After a
record with a wrong length the search continues byte by byte until records fit each other.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Metadata

from schemas.bounds import MAX_INTEGER
from schemas.work import ChunkRef
from workers.ingest.damage import damaged
from workers.ingest.index import METADATA_NAMES, IndexedChunk, PartIndex, check_size
from workers.ingest.limits import MAX_RECORDS_HOPPED
from workers.ingest.part_reader import PartReader
from workers.ingest.planning_budget import PlanningBudget
from workers.ingest.records import (
    CHUNK_FIELDS_BYTES,
    HEADER_BYTES,
    MAGIC,
    MESSAGE_FIELDS_BYTES,
    Record,
    RecordMalformedError,
    chunk_header,
    message_fields,
    message_index_fields,
    parse,
    record_header,
)

MIN_STEP_BYTES: Final = 128 * 1024
MAX_STEP_BYTES: Final = 4 * 1024 * 1024
MAX_RUN_BYTES: Final = 4 * 1024 * 1024
"""Bytes at which a run of messages outside chunks is cut, so that it is read like a chunk."""
_HOPS_PER_CANDIDATE: Final = 3
"""Hops that a test of one candidate for a record's start costs."""
_CHUNK_PEEK_BYTES: Final = CHUNK_FIELDS_BYTES + 64
_MAX_APART_NS: Final = 86_400 * 1_000_000_000


def recover_index(reader: PartReader, budget: PlanningBudget) -> PartIndex:
    """Rebuild the index of a whole part, within the budget.

    Raises:
        LogUnusableError: If it has more chunks than any recording.
    """
    index = PartIndex(number=reader.number, recovered=True)
    ended = scan_records(reader, index, budget, start=len(MAGIC), end=reader.size)
    closed = bytes(reader.read(reader.size - len(MAGIC), len(MAGIC))) == MAGIC
    if not (ended and closed):
        index.damage.append(
            damaged(
                key=reader.key,
                offset=reader.size,
                length=0,
                what="the file was never closed: it has no end mark",
            )
        )
    return index


def scan_records(
    reader: PartReader, index: PartIndex, budget: PlanningBudget, *, start: int, end: int
) -> bool:
    """Read the record headers between two offsets, and add the findings to an index.

    Where the budget does not last until the end, the rest is damage.

    Returns:
        True if the end of the data section was found.
    """
    window = _Window(reader, end, budget)
    run = _Run(index, reader.number, first_own=len(index.chunks))
    offset = start
    while offset < end:
        opcode, length = window.header(offset)
        if budget.hops < 0:
            run.close()
            what = f"more than {MAX_RECORDS_HOPPED} records without an index: the rest is not read"
            index.damage.append(
                damaged(key=reader.key, offset=offset, length=end - offset, what=what)
            )
            return False
        if not _plausible(opcode, length, end - offset):
            run.close()
            resumed = _search(window, index, offset + 1, end)
            cut = resumed == end and opcode != 0
            what = "the file ends inside a record" if cut else "bytes that are no record"
            index.damage.append(
                damaged(key=reader.key, offset=offset, length=resumed - offset, what=what)
            )
            offset = resumed
            continue
        if opcode == Opcode.DATA_END:
            run.close()
            return True
        total = HEADER_BYTES + length
        try:
            _take(window, index, run, offset, opcode, length)
        except RecordMalformedError as error:
            index.damage.append(
                damaged(key=reader.key, offset=offset, length=total, what=error.problem)
            )
        offset += total
    run.close()
    return False


@dataclass(slots=True, eq=False)
class _Run:
    """A run of records outside chunks, being collected."""

    index: PartIndex
    part: int
    first_own: int
    offset: int = -1
    length: int = 0
    times: list[int] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)

    def add(self, offset: int, length: int, channel_id: int, log_time_ns: int) -> None:
        touches = offset == self.offset + self.length
        if self.times and (not touches or self.length + length > MAX_RUN_BYTES):
            self.close()
        if not self.times:
            self.offset = offset
        self.length = offset + length - self.offset
        self.times.append(log_time_ns)
        self.counts[channel_id] = self.counts.get(channel_id, 0) + 1

    def close(self) -> None:
        if not self.times:
            return
        self.index.add_chunk(
            IndexedChunk(
                ref=ChunkRef(
                    kind="records",
                    part=self.part,
                    offset=self.offset,
                    length=self.length,
                    start_ns=min(min(self.times), MAX_INTEGER),
                    end_ns=min(max(self.times), MAX_INTEGER),
                ),
                counts=self.counts,
            )
        )
        self.offset, self.length, self.times, self.counts = -1, 0, [], {}


@dataclass(slots=True, eq=False)
class _Window:
    """Bytes around the present offset, read in steps that grow where records are small."""

    reader: PartReader
    end: int
    budget: PlanningBudget
    step: int = MIN_STEP_BYTES
    start: int = 0
    data: memoryview = field(default_factory=lambda: memoryview(b""))

    def at(self, offset: int, length: int) -> memoryview:
        length = min(length, self.end - offset)
        if not self.start <= offset <= offset + length <= self.start + len(self.data):
            near = offset <= self.start + len(self.data) + MIN_STEP_BYTES
            self.step = min(self.step * 2, MAX_STEP_BYTES) if near else MIN_STEP_BYTES
            self.start = offset
            held = self.reader.held(offset, min(length, self.end - offset))
            want = len(held) if held is not None else max(length, self.step)
            self.data = self.reader.read(offset, min(want, self.end - offset))
        return self.data[offset - self.start : offset - self.start + length]

    def header(self, offset: int) -> tuple[int, int]:
        self.budget.hops -= 1
        view = self.at(offset, HEADER_BYTES)
        return record_header(view, 0) if len(view) == HEADER_BYTES else (0, 0)


def _take(
    window: _Window, index: PartIndex, run: _Run, offset: int, opcode: int, length: int
) -> None:
    body = offset + HEADER_BYTES
    if opcode == Opcode.MESSAGE:
        fields = window.at(body, min(length, MESSAGE_FIELDS_BYTES))
        run.add(offset, HEADER_BYTES + length, *message_fields(fields))
        return
    if opcode == Opcode.CHUNK:
        run.close()
        header = chunk_header(window.at(body, min(length, _CHUNK_PEEK_BYTES)))
        first, last = sorted((header.start_ns, header.end_ns))
        index.add_chunk(
            IndexedChunk(
                ref=ChunkRef(
                    part=index.number,
                    offset=offset,
                    length=HEADER_BYTES + length,
                    start_ns=min(first, MAX_INTEGER),
                    end_ns=min(last, MAX_INTEGER),
                ),
                counts=None,
            )
        )
        return
    if opcode == Opcode.MESSAGE_INDEX:
        channel_id, messages = message_index_fields(window.at(body, min(length, 6)))
        if len(index.chunks) > run.first_own:
            _count_in_chunk(index, channel_id, messages)
        return
    if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
        return
    check_size(opcode, length)
    view = window.at(body, length)
    if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        index.add_record(Record(opcode, offset, view))
        return
    metadata = parse(Metadata, view)
    if metadata.name in METADATA_NAMES:
        index.add_metadata(metadata, length)


def _count_in_chunk(index: PartIndex, channel_id: int, messages: int) -> None:
    """Add a MessageIndex record to the chunk before it, whose messages it counts."""
    chunk = index.chunks[-1]
    if chunk.ref.kind != "chunk":
        return
    counts = {} if chunk.counts is None else chunk.counts
    counts[channel_id] = counts.get(channel_id, 0) + messages
    if chunk.counts is None:
        index.chunks[-1] = IndexedChunk(ref=chunk.ref, counts=counts)


def _plausible(opcode: int, length: int, remaining: int) -> bool:
    return opcode != 0 and length <= remaining - HEADER_BYTES


def _search(window: _Window, index: PartIndex, start: int, end: int) -> int:
    """Find the next offset at which records that fit each other begin; the end if none does."""
    offset = start
    while offset < end:
        view = window.at(offset, min(MAX_STEP_BYTES, end - offset))
        for candidate in _candidates(view):
            window.budget.hops -= _HOPS_PER_CANDIDATE
            if window.budget.hops < 0:
                return end
            if _fits(window, index, offset + candidate, end):
                return offset + candidate
            if window.start != offset:
                view = window.at(offset, min(MAX_STEP_BYTES, end - offset))
        if offset + len(view) >= end:
            break
        offset += len(view) - HEADER_BYTES + 1
    return end


def _candidates(view: memoryview) -> list[int]:
    """Return offsets where a chunk or message could begin: its opcode, and a length below 4 GiB."""
    if len(view) < HEADER_BYTES:
        return []
    data = np.frombuffer(view, dtype=np.uint8)
    last = len(data) - HEADER_BYTES + 1
    kinds = (data[:last] == Opcode.CHUNK) | (data[:last] == Opcode.MESSAGE)
    for high_byte in range(5, 9):
        kinds &= data[high_byte : high_byte + last] == 0
    return [int(offset) for offset in np.flatnonzero(kinds)]


def _fits(window: _Window, index: PartIndex, offset: int, end: int) -> bool:
    """Return True if a chunk or message with plausible fields begins here, and a record follows."""
    opcode, length = window.header(offset)
    if not _plausible(opcode, length, end - offset):
        return False
    body, after = offset + HEADER_BYTES, offset + HEADER_BYTES + length
    try:
        if opcode == Opcode.CHUNK:
            header = chunk_header(window.at(body, min(length, _CHUNK_PEEK_BYTES)))
            return (
                header.compression in ("", "lz4", "zstd")
                and header.records_offset + header.records_bytes == length
                and header.start_ns <= header.end_ns
            )
        channel_id, log_time_ns = message_fields(window.at(body, min(length, MESSAGE_FIELDS_BYTES)))
    except RecordMalformedError:
        return False
    last_ns = index.chunks[-1].ref.end_ns if index.chunks else log_time_ns
    if channel_id not in index.channels or abs(log_time_ns - last_ns) > _MAX_APART_NS:
        return False
    if after == end:
        return True
    following, following_length = window.header(after)
    return following < 0x80 and _plausible(following, following_length, end - after)
