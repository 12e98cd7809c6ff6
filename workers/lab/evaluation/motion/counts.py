"""Counts of right and wrong labels; they add up over frames and logs."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

StreamName = str
"""`selfsupervised` or `supervised`, chosen by the settings, or the name of a part."""

RANGES_M: Final = (25, 50, 80)
"""Horizontal ranges under which points are counted, metres."""

ERROR_STEP_M_PER_S: Final = 0.01
_ERROR_STEPS: Final = 6001
"""Bins of the velocity error histogram, up to 60 m/s, so that memory stays constant over logs."""


@dataclass(slots=True)
class RangeCounts:
    """Counts under one range, over frames and logs.

    Attributes:
        hits: Dynamic points labelled dynamic.
        false_alarms: Static points labelled dynamic.
        misses: Dynamic points labelled static or UNKNOWN.
        unknown: Points of known truth that the stream labels UNKNOWN.
        judged: Points of known truth.
        objects: Moving objects with enough points.
        objects_found: Those with more than half of their points labelled dynamic.
    """

    hits: int = 0
    false_alarms: int = 0
    misses: int = 0
    unknown: int = 0
    judged: int = 0
    objects: int = 0
    objects_found: int = 0

    def add(self, other: Self) -> None:
        """Add the counts of another one to these."""
        for name in self.__dataclass_fields__:
            setattr(self, name, getattr(self, name) + getattr(other, name))


def _by_range() -> dict[int, RangeCounts]:
    return {range_m: RangeCounts() for range_m in RANGES_M}


@dataclass(slots=True)
class ObjectCounts:
    """Moving objects of one kind under 80 m.

    Attributes:
        observed: Object observations with enough points, one per object and frame.
        found: Those with more than half of their points labelled dynamic.
        tracks: Log and track of each of them.
        tracks_found: Tracks found in one frame at least.
    """

    observed: int = 0
    found: int = 0
    tracks: set[tuple[str, int]] = field(default_factory=set)
    tracks_found: set[tuple[str, int]] = field(default_factory=set)

    def add(self, other: Self) -> None:
        """Add the counts of another one to these."""
        self.observed += other.observed
        self.found += other.found
        self.tracks |= other.tracks
        self.tracks_found |= other.tracks_found


ObjectKinds = dict[str, dict[str, ObjectCounts]]
"""Objects by dimension of the breakdown (`class`, `speed`, `size`, `points`), then by bin."""


@dataclass(slots=True)
class StreamCounts:
    """Counts of one stream.

    Attributes:
        by_range: Counts under each of `RANGES_M`.
        confirmed: The same if only confirmed points count as dynamic; zero where the stream
            confirms nothing.
        objects: Moving objects under 80 m by class, speed, size and points.
        false_clusters: Dynamic clusters under 80 m of at least 25 points, without a moving object.
        confirmed_false_clusters: The same for confirmed points only.
        confirms: Whether the stream marks confirmed points.
        velocity_errors: (E,) histogram of the velocity error of correctly found dynamic points.
    """

    by_range: dict[int, RangeCounts] = field(default_factory=_by_range)
    confirmed: dict[int, RangeCounts] = field(default_factory=_by_range)
    objects: ObjectKinds = field(default_factory=dict)
    false_clusters: int = 0
    confirmed_false_clusters: int = 0
    confirms: bool = False
    velocity_errors: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros(_ERROR_STEPS, np.int64)
    )

    def add(self, other: Self) -> None:
        """Add the counts of another one to these."""
        for range_m in RANGES_M:
            self.by_range[range_m].add(other.by_range[range_m])
            self.confirmed[range_m].add(other.confirmed[range_m])
        for dimension, kinds in other.objects.items():
            for kind, counts in kinds.items():
                self.objects_of(dimension, kind).add(counts)
        self.false_clusters += other.false_clusters
        self.confirmed_false_clusters += other.confirmed_false_clusters
        self.confirms |= other.confirms
        self.velocity_errors += other.velocity_errors

    def objects_of(self, dimension: str, kind: str) -> ObjectCounts:
        """Return the counts of one kind of object, creating them on first use."""
        return self.objects.setdefault(dimension, {}).setdefault(kind, ObjectCounts())

    def add_velocity_errors(self, errors_m_per_s: NDArray[np.floating]) -> None:
        """Add the velocity error of each point to the histogram; errors are capped at 60 m/s."""
        steps = np.minimum(errors_m_per_s / ERROR_STEP_M_PER_S, _ERROR_STEPS - 1).astype(np.int64)
        self.velocity_errors += np.bincount(steps, minlength=_ERROR_STEPS)


@dataclass(slots=True)
class LogCounts:
    """Counts of one log, or of all of them.

    Attributes:
        frames: Evaluated frames.
        streams: Counts of each stream.
        compared: By supervised and self-supervised stream, points that both labelled.
        contradicted: Those on which they differ.
        stage_ms: Milliseconds of each stage, and of each stream, in each evaluated frame.
    """

    frames: int = 0
    streams: dict[StreamName, StreamCounts] = field(default_factory=dict)
    compared: Counter[tuple[StreamName, StreamName]] = field(default_factory=Counter)
    contradicted: Counter[tuple[StreamName, StreamName]] = field(default_factory=Counter)
    stage_ms: dict[str, list[float]] = field(default_factory=dict)

    def add(self, other: Self) -> None:
        """Add the counts of another one to these."""
        self.frames += other.frames
        self.compared.update(other.compared)
        self.contradicted.update(other.contradicted)
        for name, counts in other.streams.items():
            self.streams.setdefault(name, StreamCounts()).add(counts)
        for stage, times in other.stage_ms.items():
            self.stage_ms.setdefault(stage, []).extend(times)


def total_of(counts: Iterable[LogCounts]) -> LogCounts:
    """Sum the counts of several logs."""
    total = LogCounts()
    for each in counts:
        total.add(each)
    return total
