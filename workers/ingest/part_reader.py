"""Part reader: range reads of one part of a recording, counted and cached."""

from dataclasses import dataclass, field
from typing import Final

from schemas.transport.bucket import Bucket
from schemas.work import Part

MAX_HELD_BYTES: Final = 16 * 1024 * 1024


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
    """

    bucket: Bucket
    part: Part
    number: int
    range_reads: int = 0
    bytes_read: int = 0
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
        return data

    def held(self, offset: int, length: int) -> memoryview | None:
        """Return these bytes if they need no request."""
        for start, data in self._held:
            if start <= offset and offset + length <= start + len(data):
                return data[offset - start : offset - start + length]
        return None
