"""Tables of motion metrics: one row for each log, and one over all logs."""

from collections.abc import Callable, Mapping, Sequence, Set
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from workers.lab.evaluation.motion.counts import (
    ERROR_STEP_M_PER_S,
    LogCounts,
    ObjectCounts,
    RangeCounts,
    StreamCounts,
    StreamName,
)

Ratios = dict[str, float | None]
"""Ratios by range in metres, `"25"`, `"50"`, `"80"`; null where there was nothing to count."""

_PERCENTILE: Final = 0.9


class FoundObjects(BaseModel):
    """Moving objects of one kind under 80 m: how many there are and how many were found."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    observations: int = Field(description="Objects of at least 20 points, per frame.")
    found: int = Field(description="Those of which more than half the points were found.")
    tracks: int = Field(description="Different objects among the observations.")
    tracks_found: int = Field(description="Those found in one frame at least.")


class StreamTable(BaseModel):
    """Motion metrics of one stream; ratios by horizontal range."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    iou: Ratios = Field(description="Dynamic points: hits / (hits + false alarms + misses).")
    precision: Ratios = Field(description="Hits / (hits + false alarms).")
    recall: Ratios = Field(description="Hits / (hits + misses).")
    object_recall: Ratios = Field(
        description="Moving objects of at least 20 points of which more than half were found."
    )
    object_recall_by_class: Ratios = Field(description="The same under 80 m, by class of truth.")
    object_recall_by_speed: Ratios = Field(description="By true speed over the ground, m/s.")
    object_recall_by_size: Ratios = Field(description="By the longest side of the true box, m.")
    object_recall_by_points: Ratios = Field(description="By points of the object in the frame.")
    objects_by_class: dict[str, FoundObjects] = Field(description="The counts behind it.")
    unknown_share: Ratios = Field(description="Points of known truth labelled UNKNOWN.")
    false_clusters_per_frame: float | None = Field(
        description="Dynamic clusters under 80 m of at least 25 points, without a mover."
    )
    confirmed_iou: Ratios = Field(
        description="IoU if only confirmed points counted as dynamic; null without confirmation."
    )
    confirmed_precision: Ratios = Field(description="Precision of confirmed points.")
    confirmed_recall: Ratios = Field(description="Recall of confirmed points.")
    confirmed_object_recall: Ratios = Field(description="Object recall of confirmed points.")
    confirmed_false_clusters_per_frame: float | None = Field(
        description="False clusters of confirmed points only; null without confirmation."
    )
    velocity_error_m_per_s: dict[str, float | None] = Field(
        description="Horizontal, of dynamic points that were found: median, mean, p90."
    )


class EvaluatedLog(BaseModel):
    """Log, stream and frames of a table."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    log: str = Field(description="Log id, or `all`.")
    stream: StreamName = Field(
        description="Stream of the figures at the top level: `selfsupervised` or "
        "`supervised`, as the settings name them, or a part by its own name."
    )
    frames: int = Field(ge=0, description="Evaluated frames.")


class LogEvaluation(StreamTable, EvaluatedLog):
    """The table of one log, or of all: figures of the evaluated stream, then of every stream."""

    ms_per_frame: dict[str, float | None] = Field(
        description="Median milliseconds of each stage in the evaluated frames, and of their total."
    )
    contradicted_share: float | None = Field(
        description="Share of compared points on which the stream and the first of the other kind "
        "differ; null where none of the other kind was run."
    )
    streams: dict[StreamName, StreamTable] = Field(description="The same table for each stream.")


def evaluation_of(
    log: str,
    counts: LogCounts,
    *,
    stream: StreamName,
    others: Sequence[StreamName] | None = None,
) -> LogEvaluation:
    """Compute the table of a log from its counts.

    Args:
        log: Log id, or `all`.
        counts: Counts of the log.
        stream: Stream of the figures at the top.
        others: Other streams of the row; all that were counted by default.
    """
    shown = {stream, *(counts.streams if others is None else others)}
    tables = {
        name: _table(stream_counts, frames=counts.frames)
        for name, stream_counts in sorted(counts.streams.items())
        if name in shown
    }
    top = tables.get(stream) or _table(StreamCounts(), frames=0)
    pair = next((pair for pair in counts.compared if stream in pair), None)
    return LogEvaluation(
        **{name: getattr(top, name) for name in StreamTable.model_fields},
        log=log,
        stream=stream,
        frames=counts.frames,
        ms_per_frame=_stage_times(counts, shown),
        contradicted_share=(
            _ratio(counts.contradicted[pair], counts.compared[pair]) if pair else None
        ),
        streams=tables,
    )


def _stage_times(counts: LogCounts, shown: Set[StreamName]) -> dict[str, float | None]:
    """Return the median of each stage and of their sum, without streams that are not shown."""
    stages = {
        stage: times
        for stage, times in counts.stage_ms.items()
        if stage in shown or stage not in counts.streams
    }
    if not stages:
        return {}
    stages["total"] = np.sum(list(stages.values()), axis=0).tolist()
    return {
        stage: round(float(np.median(times)), 3) if times else None
        for stage, times in stages.items()
    }


def _table(counts: StreamCounts, *, frames: int) -> StreamTable:
    objects = {
        f"object_recall_by_{dimension}": {
            kind: _ratio(each.found, each.observed)
            for kind, each in _in_order(counts.objects.get(dimension, {}))
        }
        for dimension in ("class", "speed", "size", "points")
    }
    return StreamTable.model_validate(
        {
            **_point_ratios(counts.by_range),
            **{f"confirmed_{k}": v for k, v in _point_ratios(counts.confirmed).items()},
            **objects,
            "objects_by_class": {
                kind: _found(each) for kind, each in _in_order(counts.objects.get("class", {}))
            },
            "unknown_share": _ratios(counts.by_range, lambda c: (c.unknown, c.judged)),
            "false_clusters_per_frame": _ratio(counts.false_clusters, frames),
            "confirmed_false_clusters_per_frame": (
                _ratio(counts.confirmed_false_clusters, frames) if counts.confirms else None
            ),
            "velocity_error_m_per_s": _velocity_error(counts.velocity_errors),
        }
    )


def _in_order(kinds: Mapping[str, ObjectCounts]) -> list[tuple[str, ObjectCounts]]:
    """Sort names alphabetically, and bins such as `10-20` by their lower edge."""

    def place(entry: tuple[str, ObjectCounts]) -> tuple[float, str]:
        first = entry[0].partition("-")[0]
        return (float(first) if first.replace(".", "").isdigit() else 0.0), entry[0]

    return sorted(kinds.items(), key=place)


def _point_ratios(by_range: Mapping[int, RangeCounts]) -> dict[str, Ratios]:
    return {
        "iou": _ratios(by_range, lambda c: (c.hits, c.hits + c.false_alarms + c.misses)),
        "precision": _ratios(by_range, lambda c: (c.hits, c.hits + c.false_alarms)),
        "recall": _ratios(by_range, lambda c: (c.hits, c.hits + c.misses)),
        "object_recall": _ratios(by_range, lambda c: (c.objects_found, c.objects)),
    }


def _ratios(
    by_range: Mapping[int, RangeCounts], of: Callable[[RangeCounts], tuple[int, int]]
) -> Ratios:
    return {str(range_m): _ratio(*of(counts)) for range_m, counts in by_range.items()}


def _ratio(part: int, whole: int) -> float | None:
    return round(part / whole, 6) if whole else None


def _found(counts: ObjectCounts) -> FoundObjects:
    return FoundObjects(
        observations=counts.observed,
        found=counts.found,
        tracks=len(counts.tracks),
        tracks_found=len(counts.tracks_found),
    )


def _velocity_error(errors: NDArray[np.int64]) -> dict[str, float | None]:
    """Return the median, mean and 90th percentile of a histogram of errors."""
    total = int(errors.sum())
    if not total:
        return {"median": None, "mean": None, "p90": None}
    middles = (np.arange(len(errors)) + 0.5) * ERROR_STEP_M_PER_S
    below = np.cumsum(errors)

    def quantile(share: float) -> float:
        return round(float(middles[np.searchsorted(below, share * total)]), 4)

    mean = round(float((middles * errors).sum() / total), 4)
    return {"median": quantile(0.5), "mean": mean, "p90": quantile(_PERCENTILE)}
