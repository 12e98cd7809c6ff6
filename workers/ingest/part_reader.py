"""Part reader: range reads of one part of a recording, counted and cached."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from schemas.transport.bucket import Bucket
from schemas.work import Part

MAX_HELD_BYTES: Final = 16 * 1024 * 1024


MAX_RECENT_BYTES: Final = 64 * 1024 * 1024
"""Bytes of an object's last reads that another reader of it may use again: some seconds of a log.
"""


@dataclass(slots=True, eq=False)
class RecentReads:
    """The last reads of one object, which another reader of the same object need not repeat.

    One thread adds, another one may search meanwhile.
    """

    _reads: tuple[tuple[int, memoryview], ...] = ()

    def add(self, offset: int, data: memoryview) -> None:
        """Keep a read, and forget the oldest ones."""
        kept: list[tuple[int, memoryview]] = []
        room = MAX_RECENT_BYTES
        for read in ((offset, data), *self._reads):
            room -= len(read[1])
            if room < 0:
                break
            kept.append(read)
        self._reads = tuple(kept)

    def find(self, offset: int, length: int) -> memoryview | None:
        """Return these bytes if one of the reads contains them."""
        return _within(self._reads, offset, length)


@dataclass(slots=True, eq=False)
class PartReader:
    """Ranges of one object, each read with its etag.

    The last read, and the tail once it was kept, need no further request: planning reads the same
    few bytes several times, and a small log fits in its tail.

    Attributes:
        bucket: Its bucket.
        part: Which object, and its number in the recording.
        number: Index into the recording's parts.
        range_reads: Requests so far.
        bytes_read: Bytes read by them.
        recent: Last reads that readers of the object share; None: not shared.
    """

    bucket: Bucket
    part: Part
    number: int
    range_reads: int = 0
    bytes_read: int = 0
    recent: RecentReads | None = None
    _held: list[tuple[int, memoryview]] = field(default_factory=list)

    @property
    def key(self) -> str:
        """Key of the object."""
        return self.part.key

    @property
    def size(self) -> int:
        """Bytes of the object."""
        return self.part.size

    def read(self, offset: int, length: int, *, keep: bool = False) -> memoryview:
        """Read exactly these bytes, or those of them that the object has.

        Args:
            offset: First byte.
            length: Number of bytes; cut at the end of the object.
            keep: Keep them for the life of this reader, not only until the next read.

        Raises:
            ObjectChangedError: If the object is no longer the listed one.
        """
        length = min(length, self.size - offset)
        if length <= 0:
            return memoryview(b"")
        found = self.held(offset, length)
        if found is not None:
            return found
        data = self.fetch(offset, length)
        if keep:
            self._held.insert(0, (offset, data))
        elif length <= MAX_HELD_BYTES:
            self._held = [*self._held[:1], (offset, data)]
        return data

    def fetch(self, offset: int, length: int) -> memoryview:
        """Read exactly these bytes and cache nothing, for chunks that are used up at once.

        Raises:
            ObjectChangedError: If the object is no longer the listed one.
        """
        data = memoryview(self.bucket.read_range(self.key, offset, length, self.part.etag))
        self.range_reads += 1
        self.bytes_read += length
        if self.recent is not None:
            self.recent.add(offset, data)
        return data

    def held(self, offset: int, length: int) -> memoryview | None:
        """Return these bytes if they need no request."""
        found = _within(self._held, offset, length)
        if found is None and self.recent is not None:
            found = self.recent.find(offset, length)
        return found


def _within(reads: Iterable[tuple[int, memoryview]], offset: int, length: int) -> memoryview | None:
    for start, data in reads:
        if start <= offset and offset + length <= start + len(data):
            return data[offset - start : offset - start + length]
    return None
