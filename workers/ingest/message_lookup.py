"""Message lookup: messages of some topics around one moment, every chunk read once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeVar

from workers.errors import ChunkUnreadableError
from workers.ingest.chunk import messages_in
from workers.ingest.decoding import MessageUnreadableError
from workers.ingest.index import IndexedChunk
from workers.ingest.limits import MAX_MOMENT_BYTES
from workers.ingest.log_index import LogIndex
from workers.ingest.messages import RawMessage
from workers.ingest.records import RecordMalformedError
from workers.ingest.topics import Topic, chunks_of, ids_in

Decoded = TypeVar("Decoded")

_OVERHEAD_BYTES: Final = 300
"""Memory of a message in addition to its payload, bytes."""


@dataclass(slots=True, eq=False)
class MessageLookup:
    """Messages of some topics around one moment.

    Attributes:
        index: Index of the log.
        topics: All topics of later queries.
        log_time_ns: The moment.
        reach_ns: Time around it in which chunks are read.
        opened: Messages of the chunks read so far, which lookups of the same topics may share.
    """

    index: LogIndex
    topics: Sequence[Topic]
    log_time_ns: int
    reach_ns: int
    opened: dict[tuple[int, int], list[RawMessage]] = field(default_factory=dict)
    _left_bytes: int = MAX_MOMENT_BYTES

    def near(self, topic: Topic) -> list[RawMessage]:
        """Return messages in the chunks within reach, else in the nearest one; nearest first."""
        chunks = sorted(chunks_of(topic.channel, self.index.parts), key=self._apart_ns)
        within = [chunk for chunk in chunks if self._apart_ns(chunk) <= self.reach_ns]
        found = [each for chunk in within or chunks[:1] for each in self._messages(chunk, topic)]
        return sorted(found, key=lambda each: abs(each.log_time_ns - self.log_time_ns))

    def all(self, topic: Topic) -> list[RawMessage]:
        """Return messages of the whole log, in its order, for topics with static content."""
        chunks = chunks_of(topic.channel, self.index.parts)
        return [each for chunk in chunks for each in self._messages(chunk, topic)]

    def _apart_ns(self, chunk: IndexedChunk) -> int:
        return max(chunk.ref.start_ns - self.log_time_ns, self.log_time_ns - chunk.ref.end_ns, 0)

    def _messages(self, chunk: IndexedChunk, topic: Topic) -> list[RawMessage]:
        where = (chunk.ref.part, chunk.ref.offset)
        if where not in self.opened:
            self.opened[where] = self._open(chunk)
        return [each for each in self.opened[where] if each.channel is topic.channel]

    def _open(self, chunk: IndexedChunk) -> list[RawMessage]:
        """Copy the wanted messages, so that the chunk itself need not stay in memory."""
        channels = {
            channel_id: topic.channel
            for topic in self.topics
            for channel_id in ids_in(topic.channel, chunk.ref.part)
        }
        found: list[RawMessage] = []
        try:
            for stored in messages_in(self.index.open(chunk.ref), channels.keys()):
                channel = channels[stored.channel_id]
                self._left_bytes -= len(stored.data) + _OVERHEAD_BYTES
                if self._left_bytes < 0:
                    return found
                found.append(RawMessage(channel, stored.log_time_ns, bytes(stored.data)))
        except (ChunkUnreadableError, RecordMalformedError):
            return found  # mining has recorded the damage; messages before it are valid
        return found


def readable(
    messages: Sequence[RawMessage], decode: Callable[[RawMessage], Decoded]
) -> list[Decoded]:
    """Decode the messages that can be decoded, in their order."""
    found: list[Decoded] = []
    for message in messages:
        try:
            found.append(decode(message))
        except MessageUnreadableError:
            continue  # of many images or transforms one may be damaged
    return found
