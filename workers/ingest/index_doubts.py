"""Doubts about a summary's chunk index: records that contradict each other, or the bytes there.

A chunk index is believed while its records fit each other, which costs no read. Where they do not,
the bytes they name are scanned instead, so that a wrong record hides no chunk.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from mcap.opcode import Opcode

from workers.ingest.index import ChunkEntry, Summary
from workers.ingest.part_reader import PartReader
from workers.ingest.records import HEADER_BYTES, MAGIC, record_header

MAX_MESSAGE_INDEX_BYTES: Final = 16 * 1024 * 1024
"""Bytes of a chunk's message index at most, a million messages; a larger claim is not believed."""

_DATA_END_BYTES: Final = HEADER_BYTES + 4
_FIRST_PRIVATE_OPCODE: Final = 0x80


def claimed_end(entry: ChunkEntry) -> int:
    """Return the end of the bytes that a chunk and its message index take by the index.

    A message index whose length is not that of its records is not believed.
    """
    if uncounted(entry):
        return entry.offset + entry.length
    return entry.offset + entry.length + min(entry.index_bytes, MAX_MESSAGE_INDEX_BYTES)


def uncounted(entry: ChunkEntry) -> bool:
    """Return True if the lengths of a chunk and its message index fit no number of messages."""
    return entry.counts is not None and -1 in entry.counts.values()


def contradicting(summary: Summary) -> set[int]:
    """Return the offsets of chunks whose index records claim the same bytes, or bytes of no chunk.

    Equal records are one. Of two that overlap neither is believed: either may be wrong.
    """
    doubted: set[int] = set()
    last_end = summary.start - _DATA_END_BYTES
    claims = sorted({(each.offset, claimed_end(each)) for each in summary.chunk_indexes})
    reached, reached_by = len(MAGIC), 0
    for offset, end in claims:
        if not len(MAGIC) <= offset < end <= last_end:
            doubted.add(offset)
            continue
        if offset < reached:
            doubted |= {offset, reached_by}
        if end > reached:
            reached, reached_by = end, offset
    return doubted


def misplaced(
    reader: PartReader, entries: Iterable[ChunkEntry], gaps: Sequence[tuple[int, int]]
) -> Iterator[int]:
    """Yield the offsets of chunks right after which no record begins: their lengths are wrong.

    Args:
        reader: The part.
        entries: The records of its chunk index.
        gaps: Stretches that no index explains; it costs a small read for each after a chunk.
    """
    before = {claimed_end(entry): entry.offset for entry in entries}
    for start, end in gaps:
        if start not in before:
            continue
        view = reader.read(start, min(HEADER_BYTES, end - start))
        opcode, length = record_header(view, 0) if len(view) == HEADER_BYTES else (0, 0)
        known = Opcode.HEADER <= opcode <= Opcode.DATA_END or opcode >= _FIRST_PRIVATE_OPCODE
        if not known or length > end - start - HEADER_BYTES:
            yield before[start]
