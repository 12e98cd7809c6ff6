"""Scanned chunks: opened once for several topics, with their messages as arrays and not objects."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from schemas.work import ChunkRef, Damage
from workers.errors import ChunkUnreadableError
from workers.ingest.chunk import messages_in
from workers.ingest.damage import damaged_chunk
from workers.ingest.limits import MAX_HELD_BYTES
from workers.ingest.log_index import LogIndex
from workers.ingest.messages import MAX_TIME_NS
from workers.ingest.records import RecordMalformedError
from workers.ingest.topics import Topic, ids_in


@dataclass(frozen=True, slots=True, eq=False)
class ScannedChunk:
    """Places of the wanted messages in an opened chunk, in the order they were written.

    Attributes:
        part: The part of the recording.
        records: The opened chunk.
        channel_ids: (M,) channel of each message, in the numbers of its part.
        log_times_ns: (M,) its log time, at most `MAX_TIME_NS`.
        offsets: (M,) first byte of its payload in the records.
        lengths: (M,) bytes of its payload.
    """

    part: int
    records: memoryview
    channel_ids: NDArray[np.int64]
    log_times_ns: NDArray[np.int64]
    offsets: NDArray[np.int64]
    lengths: NDArray[np.int64]

    @property
    def held_bytes(self) -> int:
        """Return the memory that it takes, bytes."""
        return len(self.records) + 4 * self.offsets.nbytes


@dataclass(slots=True, eq=False)
class ScannedChunks:
    """The chunks of a log, scanned for some topics.

    Attributes:
        index: Index of the log.
        topics: Topics of the wanted messages.
        damage: Chunks that cannot be read are added here, once.
    """

    index: LogIndex
    topics: Sequence[Topic]
    damage: list[Damage]
    _held: dict[tuple[int, int], ScannedChunk] = field(default_factory=dict)
    _noted: set[tuple[int, int]] = field(default_factory=set)

    def scan(self, ref: ChunkRef) -> ScannedChunk:
        """Open a chunk, or return the cached one; one that cannot be read is empty."""
        where = (ref.part, ref.offset)
        scanned = self._held.pop(where, None)
        if scanned is None:
            held_bytes = sum(each.held_bytes for each in self._held.values())
            while self._held and held_bytes > MAX_HELD_BYTES:
                held_bytes -= self._held.pop(next(iter(self._held))).held_bytes
            scanned = self._open(ref)
        self._held[where] = scanned  # the most recent one is evicted last
        return scanned

    def _open(self, ref: ChunkRef) -> ScannedChunk:
        wanted = {
            channel_id for topic in self.topics for channel_id in ids_in(topic.channel, ref.part)
        }
        records = memoryview(b"")
        rows: list[tuple[int, int, int, int]] = []
        blocks: list[NDArray[np.int64]] = []
        try:
            records = self.index.open(ref)
            for message in messages_in(records, wanted):
                if message.log_time_ns <= MAX_TIME_NS:
                    rows.append(
                        (
                            message.channel_id,
                            message.log_time_ns,
                            message.offset,
                            len(message.data),
                        )
                    )
                if len(rows) == _BLOCK:
                    blocks.append(np.array(rows, dtype=np.int64))
                    rows = []
        except (ChunkUnreadableError, RecordMalformedError) as error:
            where = (ref.part, ref.offset)
            if where not in self._noted:
                self._noted.add(where)
                key = self.index.readers[ref.part].key
                self.damage.append(damaged_chunk(key, ref, error.problem))
        table = np.concatenate((*blocks, np.array(rows, dtype=np.int64).reshape(-1, 4)))
        return ScannedChunk(ref.part, records, table[:, 0], table[:, 1], table[:, 2], table[:, 3])


_BLOCK = 10_000
"""Messages after which their numbers are packed: as Python objects they take ten times as much."""
