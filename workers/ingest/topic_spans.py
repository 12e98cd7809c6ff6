"""Topic spans: the stretches of a log with messages of a topic, from the index or from chunks."""

from collections.abc import Iterable
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.mining import Grid
from schemas.work import Channel, ChunkRef, Damage
from workers.errors import LogUnusableError
from workers.ingest.budget import drop_distant, excess_of
from workers.ingest.log_index import LogIndex
from workers.ingest.messages import MAX_TIME_NS
from workers.ingest.shard_windows import Span, shard_length_ns
from workers.ingest.topic_sampling import Sample, recorded_times
from workers.ingest.topics import chunks_of, count_in

DOUBTFUL_CHUNK_NS: Final = 10 * NS_PER_S
"""Span of a chunk from which, if it is also unusual, it is opened to read its times."""


def spans_within_reach(
    index: LogIndex, sample: Sample, *, anchor_ns: int, grid: Grid, damage: list[Damage]
) -> tuple[list[Span], int]:
    """Find the spans of a lidar that one plan can cover, and the start of their grid.

    Args:
        index: Of the log.
        sample: Of the lidar's topic.
        anchor_ns: Start of the grid unless times are wrong, nanoseconds.
        grid: Lengths of scenes and shards.
        damage: Spans that are left out are added here.

    Raises:
        LogUnusableError: If the times of the log still need too much after they are checked.
    """
    shard_ns = shard_length_ns(grid)
    log_bytes = sum(reader.size for reader in index.readers)
    spans = spans_of(index, sample, damage)
    if not excess_of(spans, anchor_ns, shard_ns, log_bytes):
        return spans, anchor_ns
    # wrong times may have its shards read far more than there is, so they are checked now
    spans = spans_of(index, sample, damage, doubted_ns=3 * shard_ns)
    spans, anchor_ns = drop_distant(spans, anchor_ns, shard_ns, index, damage)
    if refused := excess_of(spans, anchor_ns, shard_ns, log_bytes):
        raise LogUnusableError(refused)
    return spans, anchor_ns


def spans_of(
    index: LogIndex, sample: Sample, damage: list[Damage], *, doubted_ns: int | None = None
) -> list[Span]:
    """Build the spans of a topic; every chunk that lasts longer than `doubted_ns` is opened.

    Raises:
        LogUnusableError: If no chunk of the topic can be read.
    """
    chunks = chunks_of(sample.topic.channel, index.parts)
    lengths_ns = sorted(chunk.ref.end_ns - chunk.ref.start_ns for chunk in chunks)
    usual_ns = lengths_ns[len(lengths_ns) // 2]
    bounds = sample.bounds
    spans: list[Span] = []
    for chunk in chunks:
        messages = count_in(chunk, sample.topic.channel)
        doubted = doubted_ns is not None and chunk.ref.end_ns - chunk.ref.start_ns > doubted_ns
        if doubted or _is_doubtful(chunk.ref, messages=messages, usual_ns=usual_ns):
            stretches = recorded_times(index, chunk.ref, apart_ns=DOUBTFUL_CHUNK_NS, damage=damage)
            messages = -1
        else:
            stretches = [(chunk.ref.start_ns, chunk.ref.end_ns)]
        spans += [Span.of(chunk.ref, stretch, bounds, messages) for stretch in stretches]
    if not spans:
        raise LogUnusableError(f"no chunk with clouds of {sample.topic.channel.topic} can be read")
    return spans


def motion_spans(
    index: LogIndex, motion: Channel | None, sample: Sample, lidar: Iterable[Span]
) -> list[Span]:
    """Build the spans of recorded motion, or of fixes, that are in no chunk of the lidar.

    They have the lidar's delays, since their own are unknown.
    """
    if motion is None:
        return []
    known = {(span.ref.part, span.ref.offset) for span in lidar}
    bounds = sample.bounds
    return [
        Span.of(chunk.ref, (chunk.ref.start_ns, chunk.ref.end_ns), bounds, count_in(chunk, motion))
        for chunk in chunks_of(motion, index.parts)
        if (chunk.ref.part, chunk.ref.offset) not in known
    ]


def _is_doubtful(ref: ChunkRef, *, messages: int, usual_ns: int) -> bool:
    """Return True if a chunk's times in the index, which no checksum guards, are implausible."""
    length_ns = ref.end_ns - ref.start_ns
    most_ns = messages * DOUBTFUL_CHUNK_NS if messages > 0 else 360 * DOUBTFUL_CHUNK_NS
    unusual = length_ns > DOUBTFUL_CHUNK_NS and length_ns > min(10 * usual_ns, most_ns)
    return unusual or ref.end_ns > MAX_TIME_NS
