"""Log index of a recording: each part's summary where it is consistent, else a recovered one."""

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

from mcap.records import Channel

from schemas.arrays import NS_PER_S
from schemas.transport.bucket import Bucket
from schemas.work import ChunkRef, Damage, Recording
from workers.errors import ChunkUnreadableError, NotMcapError
from workers.ingest.chunk import messages_in, open_chunk, opened_bytes, too_large
from workers.ingest.damage import DamageList, damaged
from workers.ingest.footer import (
    StillGrowingError,
    TruncatedPart,
    footer_of,
    is_closed,
    read_tail,
)
from workers.ingest.index import (
    IndexedChunk,
    PartIndex,
    Summary,
    index_of,
    read_summary,
    too_many_chunks,
)
from workers.ingest.index_doubts import claimed_end, contradicting, misplaced, uncounted
from workers.ingest.index_recovery import recover_index, scan_records
from workers.ingest.limits import MAX_CHUNK_RECORDS, MAX_CHUNKS
from workers.ingest.part_reader import PartReader, RecentReads
from workers.ingest.planning_budget import PlanningBudget
from workers.ingest.records import MAGIC, RecordMalformedError, count_records, walk

UNEXPLAINED_BYTES: Final = 64 * 1024
"""Bytes outside every index from which a stretch is scanned for messages outside chunks."""

LEARNING_BYTES: Final = 64 * 1024 * 1024
"""Bytes opened at most to find the channels of chunks that do not state them."""


@dataclass(frozen=True, slots=True, eq=False)
class LogIndex:
    """Contents of a recording and their places.

    Attributes:
        recording: Its objects.
        readers: One for each part.
        parts: One for each part.
        budget: Budget left for planning.
    """

    recording: Recording
    readers: tuple[PartReader, ...]
    parts: tuple[PartIndex, ...]
    budget: PlanningBudget = field(default_factory=PlanningBudget)

    @property
    def range_reads(self) -> int:
        """Requests so far."""
        return sum(reader.range_reads for reader in self.readers)

    @property
    def bytes_read(self) -> int:
        """Bytes read by these requests."""
        return sum(reader.bytes_read for reader in self.readers)

    @property
    def damage(self) -> Iterator[Damage]:
        """Stretches that cannot be read, as far as the index shows."""
        for part in self.parts:
            yield from part.damage

    @property
    def truncated(self) -> Iterator[TruncatedPart]:
        """Objects that were never closed, and their usable lengths."""
        for reader, part in zip(self.readers, self.parts, strict=True):
            if not part.closed:
                first_ns = min((chunk.ref.start_ns for chunk in part.chunks), default=0)
                last_ns = max((chunk.ref.end_ns for chunk in part.chunks), default=0)
                yield TruncatedPart(reader.key, reader.size, (last_ns - first_ns) / NS_PER_S)

    def metadata(self, name: str) -> list[dict[str, str]]:
        """Return the metadata records of this name, in the order of the parts."""
        return [
            dict(each.metadata)
            for part in self.parts
            for each in part.metadata
            if each.name == name
        ]

    def open(self, ref: ChunkRef) -> memoryview:
        """Read and open a chunk.

        Raises:
            ChunkUnreadableError: If its bytes are invalid, or if the budget of planning is spent.
        """
        return open_from(self.readers[ref.part], ref, self.budget)


def index_recording(
    bucket: Bucket,
    recording: Recording,
    *,
    settled: bool = True,
    recent: Sequence[RecentReads] = (),
) -> LogIndex:
    """Index every part of a recording; of several, one that is no MCAP file is damage.

    Args:
        bucket: Its bucket.
        recording: Its parts.
        settled: Use a part without a valid footer as far as it goes; else it may still grow.
        recent: Last reads of each part by another reader; empty: none.

    Raises:
        NotMcapError: If no part is an MCAP file.
        LogUnusableError: If it has more chunks than planning can hold.
        StillGrowingError: If a part has no valid footer, and the recording is not settled.
        ObjectChangedError: If a part is no longer the listed one.
    """
    budget = PlanningBudget()
    readers = tuple(PartReader(bucket, part, number) for number, part in enumerate(recording.parts))
    for reader, shared in zip(readers, recent, strict=False):
        reader.recent = shared
    for reader in () if settled else readers:
        if not is_closed(reader):
            raise StillGrowingError(
                f"the file has no valid footer yet ({reader.key}, {reader.size} bytes): it is "
                "planned when that comes, or when it has not changed for a while"
            )
    parts: list[PartIndex] = []
    refused: list[NotMcapError] = []
    for reader in readers:
        try:
            parts.append(_index_part(reader, budget))
        except NotMcapError as error:
            refused.append(error)
            damage = damaged(key=reader.key, offset=0, length=reader.size, what=str(error))
            parts.append(PartIndex(number=reader.number, damage=DamageList([damage])))
        if sum(len(part.chunks) for part in parts) > MAX_CHUNKS:
            raise too_many_chunks()
    if len(refused) == len(readers):
        raise refused[0]
    return LogIndex(recording, readers, tuple(parts), budget)


def open_from(reader: PartReader, ref: ChunkRef, budget: PlanningBudget) -> memoryview:
    """Read and open a chunk of one part.

    Raises:
        ChunkUnreadableError: If its bytes are invalid, or if the budget is spent.
    """
    if error := too_large(ref, key=reader.key):
        raise error
    if problem := budget.spent:
        raise ChunkUnreadableError(
            key=reader.key, offset=ref.offset, length=ref.length, problem=problem
        )
    data = reader.read(ref.offset, ref.length)
    budget.stored_bytes -= ref.length
    budget.opened_bytes -= opened_bytes(data, ref)
    records = open_chunk(data, ref, key=reader.key)
    budget.records -= count_records(records, most=MAX_CHUNK_RECORDS)
    return records


def _index_part(reader: PartReader, budget: PlanningBudget) -> PartIndex:
    try:
        summary = read_summary(reader)
    except RecordMalformedError as error:
        index = recover_index(reader, budget)
        index.damage.append(
            damaged(
                key=reader.key,
                offset=min(error.offset, reader.size),
                length=0,
                what=f"{error.problem}: the file was looked through instead",
            )
        )
    else:
        if summary is None:
            index = recover_index(reader, budget)
        else:
            index = index_of(summary, reader)
            indexed, counted = _messages_indexed(index), _messages_counted(summary)
            doubted = contradicting(summary)
            if doubted or indexed is None or indexed != counted:
                certain = not index.chunks or (indexed is not None and counted is not None)
                _scan_gaps(reader, index, summary, budget, doubted=doubted, thoroughly=certain)
    index.closed = not index.recovered or footer_of(read_tail(reader)) is not None
    # of a chunk that is both indexed and found, the index comes first and stays
    by_offset: dict[int, IndexedChunk] = {}
    for chunk in index.chunks:
        by_offset.setdefault(chunk.ref.offset, chunk)
    index.chunks = [by_offset[offset] for offset in sorted(by_offset)]
    _learn_channels(reader, index, budget)
    return index


def _messages_counted(summary: Summary) -> int | None:
    """Return the number of messages by the writer's own count; None without one."""
    return None if summary.statistics is None else summary.statistics.message_count


def _messages_indexed(index: PartIndex) -> int | None:
    """Count the messages in the chunks of the index; None where that is unknown."""
    indexed = 0
    for chunk in index.chunks:
        if chunk.counts is None or -1 in chunk.counts.values():
            return None
        indexed += sum(chunk.counts.values())
    return indexed


def _scan_gaps(
    reader: PartReader,
    index: PartIndex,
    summary: Summary,
    budget: PlanningBudget,
    *,
    doubted: set[int],
    thoroughly: bool,
) -> None:
    """Scan bytes that no believed index explains for chunks, and messages outside chunks.

    Args:
        reader: The part.
        index: Its index; chunks at doubted places are removed, and what is found is added.
        summary: Its summary.
        budget: Budget of planning.
        doubted: Offsets of chunks whose index records contradict others.
        thoroughly: Scan short stretches too. Those with a doubted chunk always are, and those
            after a chunk whose messages its index does not count.
    """
    end = summary.start

    def worth(gap: tuple[int, int]) -> bool:
        start, length = gap[0], gap[1] - gap[0]
        long = thoroughly or length > UNEXPLAINED_BYTES or reader.held(start, length) is not None
        return long or start in after_uncounted

    after_uncounted = {claimed_end(entry) for entry in summary.chunk_indexes if uncounted(entry)}
    asked = [each for each in _gaps(_explained(summary, doubted), len(MAGIC), end) if worth(each)]
    wrong = doubted | set(misplaced(reader, summary.chunk_indexes, asked))
    _remove_chunks(index, wrong, key=reader.key)
    for gap in _gaps(_explained(summary, wrong), len(MAGIC), end):
        if worth(gap) or any(gap[0] <= offset < gap[1] for offset in wrong):
            scan_records(reader, index, budget, start=gap[0], end=gap[1])


def _remove_chunks(index: PartIndex, wrong: set[int], *, key: str) -> None:
    """Remove chunks that the index describes wrongly, and record that their bytes are scanned."""
    offsets = [chunk.ref.offset for chunk in index.chunks if chunk.ref.offset in wrong]
    if offsets:
        what = (
            f"the index is wrong about {len(offsets)} chunks: their bytes were looked through "
            "instead"
        )
        index.damage.append(damaged(key=key, offset=min(offsets), length=0, what=what))
        index.chunks = [chunk for chunk in index.chunks if chunk.ref.offset not in wrong]


def _explained(summary: Summary, doubted: set[int]) -> list[tuple[int, int]]:
    """Return the bytes of believed chunks, and of attachments that overlap no indexed chunk."""
    starts = sorted(entry.offset for entry in summary.chunk_indexes)
    chunks = [
        (entry.offset, claimed_end(entry))
        for entry in summary.chunk_indexes
        if entry.offset not in doubted
    ]
    attachments = [
        (each.offset, each.offset + each.length)
        for each in summary.attachment_indexes
        if bisect_left(starts, each.offset) == bisect_left(starts, each.offset + each.length)
    ]
    return [*chunks, *attachments]


def _gaps(known: Iterable[tuple[int, int]], start: int, end: int) -> Iterator[tuple[int, int]]:
    for first, last in sorted(known):
        if start < first <= end:
            yield start, first
        start = max(start, last)
    if start < end:
        yield start, end


def _learn_channels(reader: PartReader, index: PartIndex, budget: PlanningBudget) -> None:
    """Open chunks whose channels are named nowhere else, within the budget."""
    opened_bytes = 0
    for number, chunk in enumerate(index.chunks):
        if not _has_unknown_channels(index, chunk):
            continue
        if chunk.counts is None and opened_bytes > LEARNING_BYTES:
            continue
        opened_bytes += chunk.ref.length
        try:
            records = open_from(reader, chunk.ref, budget)
        except ChunkUnreadableError:
            continue  # the reader of its messages reads it again and records the damage
        counts: dict[int, int] = {}
        try:
            _learn(records, index)
            for message in messages_in(records):
                counts[message.channel_id] = counts.get(message.channel_id, 0) + 1
        except RecordMalformedError:
            continue  # as above
        index.chunks[number] = IndexedChunk(ref=chunk.ref, counts=counts)


def _has_unknown_channels(index: PartIndex, chunk: IndexedChunk) -> bool:
    if chunk.counts is None:
        lacking = any(_lacks_schema(index, channel) for channel in index.channels.values())
        return index.recovered or not index.channels or lacking
    return any(
        channel_id not in index.channels or _lacks_schema(index, index.channels[channel_id])
        for channel_id in chunk.counts
    )


def _lacks_schema(index: PartIndex, channel: Channel) -> bool:
    return channel.schema_id != 0 and channel.schema_id not in index.schemas


def _learn(records: memoryview, index: PartIndex) -> None:
    for number, record in enumerate(walk(records)):
        if number == MAX_CHUNK_RECORDS:
            return  # the reader of the messages records that as damage
        index.add_record(record)
