"""Shard windows: a log's stretch of time, cut by pure functions of numbers.

All times here are frame stamps. The index of a chunk has its log times and its number of messages;
`StampBounds` limits the difference between stamps and log times.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from schemas.mining import Grid
from schemas.work import ChunkRef
from workers.ingest.messages import MAX_TIME_NS
from workers.ingest.scenes import CutRule

FARTHEST_NS: Final = MAX_TIME_NS + MAX_TIME_NS // 2
"""Bound of instants, before and after 1970: with any length added they fit an int64."""


@dataclass(frozen=True, slots=True)
class StampBounds:
    """Least and greatest delay from the stamp of a message to its log time."""

    least_ns: int = 0
    most_ns: int = 0


@dataclass(frozen=True, slots=True)
class Span:
    """A chunk in planning.

    Attributes:
        ref: The bytes, and the log times inside.
        earliest_ns: No stamp inside is earlier.
        latest_ns: No stamp inside is later.
        messages: Messages of the lidar inside; -1 where unknown.
    """

    ref: ChunkRef
    earliest_ns: int
    latest_ns: int
    messages: int

    @classmethod
    def of(
        cls, ref: ChunkRef, stretch_ns: tuple[int, int], bounds: StampBounds, messages: int
    ) -> "Span":
        """Build the span of a chunk, or a part of it, from its first and last log time."""
        start_ns, end_ns = stretch_ns
        return cls(
            ref,
            earliest_ns=_within(start_ns - bounds.most_ns),
            latest_ns=_within(end_ns - bounds.least_ns),
            messages=messages,
        )


@dataclass(frozen=True, slots=True)
class Window:
    """One shard's stretch of time; the fields are those of `schemas.work.Shard`."""

    index: int
    warmup_start_ns: int
    start_ns: int
    end_ns: int
    lookahead_end_ns: int
    before_lookahead_end_ns: int = 0
    first_of_log: bool = False
    last_of_log: bool = False

    def reads(self, spans: "Spans") -> list[ChunkRef]:
        """Return the chunks that the shard must read."""
        return spans.between(
            None if self.first_of_log else self.warmup_start_ns,
            None if self.last_of_log else max(self.lookahead_end_ns, self.end_ns),
        )

    def needs(self, spans: "Spans") -> list[ChunkRef]:
        """Return the chunks in which scored messages may be."""
        return spans.between(
            None if self.first_of_log else self.start_ns,
            None if self.last_of_log else self.end_ns,
        )


class Spans:
    """Many chunks, for queries by time."""

    def __init__(self, spans: Sequence[Span]) -> None:
        """Take any number, in any order."""
        self._refs = [span.ref for span in spans]
        self._earliest = np.array([span.earliest_ns for span in spans], dtype=np.int64)
        self._latest = np.array([span.latest_ns for span in spans], dtype=np.int64)

    def between(self, start_ns: int | None, end_ns: int | None) -> list[ChunkRef]:
        """Return chunks that may have stamps in a stretch of time, each once, by log time.

        Args:
            start_ns: First instant; None for the log's begin.
            end_ns: First instant after; None for the log's end.
        """
        inside_mask = np.ones(len(self._refs), dtype=np.bool_)
        if start_ns is not None:
            inside_mask &= self._latest >= start_ns
        if end_ns is not None:
            inside_mask &= self._earliest < end_ns
        refs = (self._refs[number] for number in np.flatnonzero(inside_mask))
        return [by_place for _, by_place in sorted({_place(ref): ref for ref in refs}.items())]


def cut_windows(
    spans: Sequence[Span], *, grid: Grid, anchor_ns: int, least_step_ns: int, ahead_ns: int = 0
) -> list[Window]:
    """Cut a log into the windows of its shards, on the grid that begins at the anchor.

    Windows without any chunk are left out. A last window shorter than the shortest scene is merged
    with the one before it.

    Args:
        spans: Chunks with messages of the lidar; at least one.
        grid: Lengths of scenes, shards and warm-up.
        anchor_ns: First frame of the log.
        least_step_ns: Shortest step between frames of this lidar; 0 where unknown.
        ahead_ns: Longest wait of a frame's labels for later frames.
    """
    rule = CutRule.of(grid.scene_s)
    shard_ns = shard_length_ns(grid)
    warmup_ns = max(round(grid.warmup_s * 1e9), rule.lookbehind_ns)
    latest_ns = max(span.latest_ns for span in spans)
    occupied = _occupied(spans, anchor_ns=anchor_ns, shard_ns=shard_ns)
    tail_ns = latest_ns - (anchor_ns + occupied[-1] * shard_ns)
    if len(occupied) > 1 and occupied[-1] == occupied[-2] + 1 and tail_ns < rule.min_scene_ns:
        occupied.pop()
    ordered = sorted(spans, key=lambda span: (span.earliest_ns, span.latest_ns))
    latest = np.array([span.latest_ns for span in ordered], dtype=np.int64)
    windows: list[Window] = []
    present = set(occupied)
    for index in occupied:
        start_ns = anchor_ns + index * shard_ns
        end_ns = start_ns + shard_ns
        around = int(np.argmax(latest >= end_ns - rule.max_gap_ns))
        looks_ahead = index + 1 in present and not is_continuous(
            (ordered[number] for number in range(around, len(ordered))),
            start_ns=end_ns,
            end_ns=end_ns + rule.max_gap_ns + rule.min_scene_ns,
            max_gap_ns=rule.max_gap_ns,
            least_step_ns=least_step_ns,
        )
        before = windows[-1] if windows and windows[-1].index == index - 1 else None
        windows.append(
            Window(
                index=index,
                warmup_start_ns=max(start_ns - warmup_ns, anchor_ns, 0),
                start_ns=start_ns,
                end_ns=end_ns,
                lookahead_end_ns=end_ns + max(rule.lookahead_ns if looks_ahead else 0, ahead_ns),
                before_lookahead_end_ns=before.lookahead_end_ns if before else 0,
            )
        )
    windows[0] = replace(windows[0], first_of_log=True)
    last_end_ns = max(windows[-1].end_ns, latest_ns + 1)
    windows[-1] = replace(
        windows[-1], last_of_log=True, end_ns=last_end_ns, lookahead_end_ns=last_end_ns
    )
    return windows


def shard_length_ns(grid: Grid) -> int:
    """Return the length of a shard, rounded to whole cells.

    Every scene's cell is therefore in one shard.
    """
    return round(grid.shard_s / grid.scene_s) * CutRule.of(grid.scene_s).cell_ns


def cells_of(spans: Iterable[Span], *, anchor_ns: int, shard_ns: int) -> list[tuple[int, int]]:
    """Return the numbers of each span's first and last window."""
    return [
        (
            max((span.earliest_ns - anchor_ns) // shard_ns, 0),
            max((span.latest_ns - anchor_ns) // shard_ns, 0),
        )
        for span in spans
    ]


def is_continuous(
    ordered: Iterable[Span],
    *,
    start_ns: int,
    end_ns: int,
    max_gap_ns: int,
    least_step_ns: int,
) -> bool:
    """Return True if the index alone proves a stretch of time without a gap between frames.

    A chunk has `n` frames somewhere between its earliest and latest time, none closer than the
    least step. No two neighbours in it are therefore farther apart than its length less `n - 2`
    steps. The last of one chunk and the first of the next are bounded in the same way.

    Args:
        ordered: Chunks, earliest first.
        start_ns: Start of the stretch.
        end_ns: Its end; a frame must be known to be at or after it.
        max_gap_ns: Largest step that is no gap.
        least_step_ns: Shortest step between frames; 0 makes only single frames provable.
    """
    before: Span | None = None
    for span in ordered:
        if span.latest_ns < start_ns - max_gap_ns:
            continue
        if span.messages < 1 or (before is None and span.earliest_ns > start_ns):
            return False
        inside_ns = span.latest_ns - span.earliest_ns - (span.messages - 2) * least_step_ns
        if span.messages > 1 and inside_ns > max_gap_ns:
            return False
        if before is not None:
            steps = before.messages + span.messages - 2
            between_ns = span.latest_ns - before.earliest_ns - steps * least_step_ns
            if between_ns > max_gap_ns or before.latest_ns > span.latest_ns:
                return False
        if span.earliest_ns + (span.messages - 1) * least_step_ns >= end_ns:
            return True
        before = span
    return False


def _occupied(spans: Sequence[Span], *, anchor_ns: int, shard_ns: int) -> list[int]:
    numbers: set[int] = set()
    for first, last in cells_of(spans, anchor_ns=anchor_ns, shard_ns=shard_ns):
        numbers.update(range(first, last + 1))
    return sorted(numbers)


def _within(instant_ns: int) -> int:
    return min(max(instant_ns, -FARTHEST_NS), FARTHEST_NS)


def _place(ref: ChunkRef) -> tuple[int, int, int]:
    return ref.start_ns, ref.part, ref.offset
