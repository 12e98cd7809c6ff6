"""Counts of right and wrong labels, and the table of ratios that is made of them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field

StreamName = Literal["selfsupervised", "supervised"]

RANGES_M: Final = (25, 50, 80)
"""Horizontal ranges under which points are counted."""

Ratios = dict[str, float | None]
"""By range in metres, `"25"`, `"50"`, `"80"`; null where nothing was there to be counted."""


@dataclass(slots=True)
class RangeCounts:
    """What was counted under one range, over frames and logs.

    Attributes:
        hits: Points that are dynamic and were called so.
        false_alarms: Points that are static and were called dynamic.
        misses: Points that are dynamic and were not called so; UNKNOWN is no such call.
        unknown: Points of known truth on which the stream said UNKNOWN.
        judged: Points of known truth.
        objects: Moving objects with enough points.
        objects_found: Those of which more than half the points were called dynamic.
    """

    hits: int = 0
    false_alarms: int = 0
    misses: int = 0
    unknown: int = 0
    judged: int = 0
    objects: int = 0
    objects_found: int = 0

    def add(self, other: Self) -> None:
        """Add another's counts to these."""
        for name in self.__dataclass_fields__:
            setattr(self, name, getattr(self, name) + getattr(other, name))


@dataclass(slots=True)
class StreamCounts:
    """What was counted of one stream.

    Attributes:
        by_range: Counts under each of `RANGES_M`.
        false_clusters: Dynamic clusters of at least 25 points under 80 m with nothing moving in.
        has_tracks: Whether any truth told objects apart.
    """

    by_range: dict[int, RangeCounts] = field(
        default_factory=lambda: {r: RangeCounts() for r in RANGES_M}
    )
    false_clusters: int = 0
    has_tracks: bool = False

    def add(self, other: Self) -> None:
        """Add another's counts to these."""
        for range_m, counts in self.by_range.items():
            counts.add(other.by_range[range_m])
        self.false_clusters += other.false_clusters
        self.has_tracks |= other.has_tracks


@dataclass(slots=True)
class LogCounts:
    """What was counted in one log, or in all of them.

    Attributes:
        frames: Frames that were judged.
        streams: Counts of each stream.
        compared: Points that both streams labelled.
        contradicted: Those on which they differ.
    """

    frames: int = 0
    streams: dict[StreamName, StreamCounts] = field(default_factory=dict)
    compared: int = 0
    contradicted: int = 0

    def add(self, other: Self) -> None:
        """Add another's counts to these."""
        self.frames += other.frames
        self.compared += other.compared
        self.contradicted += other.contradicted
        for name, counts in other.streams.items():
            self.streams.setdefault(name, StreamCounts()).add(counts)


class StreamTable(BaseModel):
    """How right one stream's motion labels are; ratios by horizontal range."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    iou: Ratios = Field(description="Dynamic points: hits / (hits + false alarms + misses).")
    precision: Ratios = Field(description="Hits / (hits + false alarms).")
    recall: Ratios = Field(description="Hits / (hits + misses).")
    object_recall: Ratios = Field(
        description="Moving objects of at least 20 points of which more than half were found."
    )
    unknown_share: Ratios = Field(description="Points of known truth labelled UNKNOWN.")
    false_clusters_per_frame: float | None = Field(
        description="Clusters of at least 25 points called dynamic, under 80 m, nothing moving in."
    )


class JudgedLog(BaseModel):
    """Which log a table is about."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    log: str = Field(description="Log id, or `all`.")
    stream: StreamName = Field(description="Whose figures stand at the top level.")
    frames: int = Field(ge=0, description="Frames that were judged.")


class LogEvaluation(StreamTable, JudgedLog):
    """The table of one log, or of all: the judged stream's own, then every stream's."""

    contradicted_share: float | None = Field(
        description="Share of compared points on which the streams differ; null with one stream."
    )
    streams: dict[StreamName, StreamTable] = Field(description="The same table for each stream.")


def evaluation_of(log: str, counts: LogCounts, *, stream: StreamName) -> LogEvaluation:
    """Turn what was counted in a log into its table."""
    tables = {
        name: _table(stream_counts, frames=counts.frames)
        for name, stream_counts in sorted(counts.streams.items())
    }
    top = tables.get(stream) or _table(StreamCounts(), frames=0)
    return LogEvaluation(
        **top.model_dump(),
        log=log,
        stream=stream,
        frames=counts.frames,
        contradicted_share=_ratio(counts.contradicted, counts.compared),
        streams=tables,
    )


def total_of(counts: Iterable[LogCounts]) -> LogCounts:
    """Sum the counts of several logs."""
    total = LogCounts()
    for each in counts:
        total.add(each)
    return total


def _table(counts: StreamCounts, *, frames: int) -> StreamTable:
    by_range = counts.by_range
    return StreamTable(
        iou=_ratios(by_range, ("hits",), ("hits", "false_alarms", "misses")),
        precision=_ratios(by_range, ("hits",), ("hits", "false_alarms")),
        recall=_ratios(by_range, ("hits",), ("hits", "misses")),
        object_recall=_ratios(by_range, ("objects_found",), ("objects",)),
        unknown_share=_ratios(by_range, ("unknown",), ("judged",)),
        false_clusters_per_frame=_ratio(counts.false_clusters, frames),
    )


def _ratios(
    by_range: Mapping[int, RangeCounts], part: tuple[str, ...], whole: tuple[str, ...]
) -> Ratios:
    return {
        str(range_m): _ratio(
            sum(getattr(counts, name) for name in part),
            sum(getattr(counts, name) for name in whole),
        )
        for range_m, counts in by_range.items()
    }


def _ratio(part: int, whole: int) -> float | None:
    return round(part / whole, 6) if whole else None
