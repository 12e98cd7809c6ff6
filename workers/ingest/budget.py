"""Planning limits: the time span of a log's messages, and the bytes that its shards would read."""

from collections.abc import Sequence

from schemas.arrays import NS_PER_S
from schemas.bounds import MAX_SHARDS_OF_A_PLAN
from schemas.work import Damage
from workers.ingest.damage import damaged_chunk
from workers.ingest.limits import FREE_READ_BYTES, MAX_CHUNKS_OF_SHARDS, MAX_READ_TIMES
from workers.ingest.log_index import LogIndex
from workers.ingest.shard_windows import Span, cells_of


def excess_of(spans: Sequence[Span], anchor_ns: int, shard_ns: int, log_bytes: int) -> str:
    """Return why the shards of these spans would be too many or too large; empty if they are not.

    Args:
        spans: Chunks of a lidar.
        anchor_ns: Start of its grid.
        shard_ns: Length of a shard.
        log_bytes: Bytes of the recording.
    """
    most_bytes = max(MAX_READ_TIMES * log_bytes, FREE_READ_BYTES)
    named, read_bytes, farthest = 0, 0, 0
    for span, (first, last) in zip(
        spans, cells_of(spans, anchor_ns=anchor_ns, shard_ns=shard_ns), strict=True
    ):
        named += last + 1 - first
        read_bytes += (last + 1 - first) * span.ref.length
        farthest = max(farthest, last)
    if farthest >= MAX_SHARDS_OF_A_PLAN:
        return (
            f"its messages lie so far apart that it would be mined in more than "
            f"{MAX_SHARDS_OF_A_PLAN} shards; set a larger shard_s if that is meant"
        )
    if named > MAX_CHUNKS_OF_SHARDS:
        return (
            f"by the times of its chunks its shards would name {named} of them, more than "
            f"{MAX_CHUNKS_OF_SHARDS}: repair its index, or split the recording"
        )
    if read_bytes > most_bytes:
        return (
            f"by the times of its chunks its shards would read {read_bytes} bytes of a recording "
            f"of {log_bytes}: repair its index, or write smaller chunks"
        )
    return ""


def drop_distant(
    spans: Sequence[Span], anchor_ns: int, shard_ns: int, index: LogIndex, damage: list[Damage]
) -> tuple[list[Span], int]:
    """Drop spans farther from most of a log than one plan reaches: their times are wrong.

    Args:
        spans: Chunks of a lidar; at least one.
        anchor_ns: Start of the log's grid.
        shard_ns: Length of a shard.
        index: Of the log.
        damage: Dropped spans are added here.

    Returns:
        The kept spans, and the start of their grid: the anchor, unless it is itself too far away.
    """
    reach_ns = MAX_SHARDS_OF_A_PLAN * shard_ns
    if all(span.latest_ns < anchor_ns + reach_ns for span in spans):
        return list(spans), anchor_ns
    ordered = sorted(spans, key=lambda span: span.earliest_ns)
    best_bytes, best, inside_bytes, begin = -1, 0, 0, 0
    for span in ordered:
        inside_bytes += span.ref.length
        while span.earliest_ns >= ordered[begin].earliest_ns + reach_ns:
            inside_bytes -= ordered[begin].ref.length
            begin += 1
        if inside_bytes > best_bytes:
            best_bytes, best = inside_bytes, begin
    start_ns = ordered[best].earliest_ns
    end_ns = start_ns + reach_ns
    kept: list[Span] = []
    for span in spans:
        if start_ns <= span.latest_ns and span.earliest_ns < end_ns:
            kept.append(span)
            continue
        days = abs(span.earliest_ns - start_ns) / (86_400 * NS_PER_S)
        what = f"messages {days:.0f} days from the rest of the log, farther than a plan reaches"
        damage.append(damaged_chunk(index.readers[span.ref.part].key, span.ref, what))
    return kept, anchor_ns if start_ns <= anchor_ns < end_ns else max(start_ns, 0)
