"""Chunk prefetching: a shard's chunks are read and opened ahead, neighbours in one request."""

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Final

from schemas.work import ChunkRef
from workers.errors import ChunkUnreadableError
from workers.ingest.chunk import open_chunk, opened_bytes, too_large
from workers.ingest.limits import MAX_AHEAD_BYTES
from workers.ingest.part_reader import PartReader

MAX_READ_BYTES: Final = 8 * 1024 * 1024
"""Bytes up to which neighbouring chunks are read together."""

MAX_BETWEEN_BYTES: Final = 64 * 1024
"""Bytes between two chunks that are read together: message indexes, mostly."""


AHEAD: Final = 2
"""Chunks opened ahead of their use; these and one read are in memory."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenedChunk:
    """A chunk's records, or the error of reading them."""

    ref: ChunkRef
    records: memoryview
    error: ChunkUnreadableError | None = None


@dataclass(slots=True, eq=False)
class _Fetched:
    """A chunk on its way: opened already, unless it is so large that it waits for its turn."""

    opened: OpenedChunk | None = None
    stored: memoryview | None = None


def fetch_chunks(readers: Sequence[PartReader], refs: Sequence[ChunkRef]) -> Iterator[OpenedChunk]:
    """Yield the chunks in the given order; one thread reads and opens the next ones.

    Large ones are not read, or not opened, before all those before them are used up.

    Args:
        readers: One for each part of the recording; not to be used elsewhere meanwhile.
        refs: Chunks to read, in the order of their use.

    Raises:
        ObjectChangedError: If an object is no longer the planned one.
        BucketUnreachableError: If the bucket does not answer.
    """
    fetcher = _Fetcher(readers)
    coming: deque[tuple[ChunkRef, Future[_Fetched]]] = deque()
    pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="fetch")
    try:
        for group in neighbours(refs):
            for ref in group:
                ahead = AHEAD if ref.length <= MAX_AHEAD_BYTES else 0
                while coming and len(coming) > ahead:
                    yield fetcher.take(*coming.popleft())
                coming.append((ref, pool.submit(fetcher.fetch, ref, group)))
                if len(coming) > ahead:
                    yield fetcher.take(*coming.popleft())
        while coming:
            yield fetcher.take(*coming.popleft())
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def neighbours(refs: Sequence[ChunkRef]) -> list[list[ChunkRef]]:
    """Group chunks that follow each other closely in one object, up to the size of one read."""
    groups: list[list[ChunkRef]] = []
    for ref in refs:
        if groups:
            first, last = groups[-1][0], groups[-1][-1]
            between = ref.offset - (last.offset + last.length)
            fits = ref.offset + ref.length - first.offset <= MAX_READ_BYTES
            if ref.part == last.part and 0 <= between <= MAX_BETWEEN_BYTES and fits:
                groups[-1].append(ref)
                continue
        groups.append([ref])
    return groups


@dataclass(slots=True, eq=False)
class _Fetcher:
    """Opens chunk after chunk, in its one thread, and reads a group at its first chunk."""

    readers: Sequence[PartReader]
    data: memoryview = field(default_factory=lambda: memoryview(b""))

    def fetch(self, ref: ChunkRef, group: Sequence[ChunkRef]) -> _Fetched:
        """Read a chunk, and open it unless it is large."""
        reader, start = self.readers[ref.part], group[0].offset
        if error := too_large(ref, key=reader.key):
            return _Fetched(OpenedChunk(ref, memoryview(b""), error))
        if ref is group[0]:
            self.data = memoryview(b"")  # frees the last group before this one is read
            self.data = reader.fetch(start, group[-1].offset + group[-1].length - start)
        data = self.data[ref.offset - start :][: ref.length]
        if ref.length > MAX_AHEAD_BYTES:
            self.data = memoryview(b"")
        if opened_bytes(data, ref) > MAX_AHEAD_BYTES:
            return _Fetched(stored=data)
        return _Fetched(self._open(ref, data))

    def take(self, ref: ChunkRef, coming: Future[_Fetched]) -> OpenedChunk:
        """Wait for a chunk, and open it now if that was postponed."""
        fetched = coming.result()
        if fetched.opened is not None:
            return fetched.opened
        stored = memoryview(b"") if fetched.stored is None else fetched.stored
        return self._open(ref, stored)

    def _open(self, ref: ChunkRef, data: memoryview) -> OpenedChunk:
        try:
            return OpenedChunk(ref, open_chunk(data, ref, key=self.readers[ref.part].key))
        except ChunkUnreadableError as error:
            return OpenedChunk(ref, memoryview(b""), error)
