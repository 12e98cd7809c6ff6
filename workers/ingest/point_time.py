"""Point times: the instant of each point within its sweep, from any driver's field and unit.

Fields of common drivers (from their repositories and message definitions):

| field                         | type    | unit                     | written by          |
|-------------------------------|---------|--------------------------|---------------------|
| `t`                           | uint32  | ns after the stamp       | Ouster              |
| `time`                        | float32 | s, negative if stamp=end | Velodyne            |
| `timestamp`                   | float64 | s since the epoch        | Hesai, Robosense    |
| `timestamp`                   | float64 | ns since the epoch       | Livox (ROS 2)       |
| `offset_time`                 | uint32  | ns after the stamp       | Livox               |
| `offset_ns`, `time_offset_ns` | int32   | ns after the stamp       | Argoverse 2, Aeva   |
| `time_stamp`                  | uint32  | ns after the stamp       | Autoware's Nebula   |
| `time_us`, `t_us`             | any     | us after the stamp       | converters          |

A suffix in the name settles the unit; otherwise the numbers do. Times since the epoch in ns, us and
ms are recognised by their size. Floats that are far from zero relative to their spread count from
another origin, the epoch or the start of the week, and their differences show the unit. A sweep
lasts 10 ms to 2 s, so its length in s, ms, us and ns cannot be mistaken. All else is an offset.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.frame import StampAt

TIME_FIELDS: Final = (
    "t", "time", "timestamp", "time_stamp", "offset_ns", "offset_time", "time_offset",
    "time_offset_ns", "timestamp_ns", "time_ns", "t_ns", "offset_us", "time_offset_us", "time_us",
    "timestamp_us", "t_us", "time_ms", "t_ms", "time_s", "t_s", "time_sec", "relative_time",
    "relative_timestamp", "point_time_offset", "t_offset", "dt", "deltaT", "firing_time",
)  # fmt: skip
"""Time fields in order of preference; the first in a cloud counts."""

_SUFFIX_NS: Final[Mapping[str, int]] = {
    "_ns": 1, "_us": 1_000, "_ms": 1_000_000, "_s": NS_PER_S, "_sec": NS_PER_S,
}  # fmt: skip

_SINCE_EPOCH_NS: Final[tuple[tuple[float, int], ...]] = (
    (1e17, 1),
    (1e14, 1_000),
    (1e11, 1_000_000),
)
"""Times since the epoch (after 1973) exceed the first number in the unit of the second, in ns."""

_WITHIN_SWEEP_NS: Final[tuple[tuple[float, int], ...]] = (
    (2e6, 1),
    (2e3, 1_000),
    (2.0, 1_000_000),
    (0.0, NS_PER_S),
)
"""The same for times within a sweep: a unit is too coarse if it made the sweep exceed 2 s."""

FAR_FROM_ZERO: Final = 100
"""Ratio of size to spread from which floats do not count from the sweep's own stamp."""

LEAST_STEPS: Final = 16
"""Distinct steps of a float within a sweep at least; with fewer a cloud has no point times."""

MAX_SAMPLE: Final = 4096
"""Points that determine unit and origin, spread over the whole cloud."""

_NS_BY_CONVENTION: Final = ("t", "time_stamp", "offset_time")
"""Integer fields of these names are in ns even in a fragment of a sweep (Ouster, Nebula, Livox)."""

MAX_OFFSET_NS: Final = 2 * NS_PER_S
"""Largest time between a point and its stamp; a larger one is invalid."""


@dataclass(frozen=True, slots=True, eq=False)
class PointTime:
    """Time of each point relative to the stamp of its frame.

    Attributes:
        offset_ns: (N,) int32; zero where nothing plausible was recorded.
        recorded: The log has different times for the points.
    """

    offset_ns: NDArray[np.int32]
    recorded: bool


@np.errstate(over="ignore", invalid="ignore")  # clouds contain odd numbers
def point_time(
    fields: Mapping[str, NDArray[Any]], *, points: int, stamp_ns: int, stamp_at: StampAt
) -> PointTime:
    """Find each point's time after the stamp.

    Times since the epoch that are more than two seconds from the stamp come from another clock.
    Then only their differences count, and `stamp_at` defines which of them the stamp refers to.

    Args:
        fields: The cloud's fields.
        points: N.
        stamp_ns: Of the frame, nanoseconds since the Unix epoch.
        stamp_at: Instant of the sweep that the stamp refers to.
    """
    name = next((name for name in TIME_FIELDS if name in fields and fields[name].ndim == 1), None)
    if name is None or points == 0:
        return PointTime(np.zeros(points, dtype=np.int32), recorded=False)
    values = fields[name]
    finite_mask = np.isfinite(values)
    if not finite_mask.any():
        return PointTime(np.zeros(points, dtype=np.int32), recorded=False)
    unit = _unit(name, values[finite_mask])
    if unit.from_stamp:
        offset = values.astype(np.float64) * unit.ns
    else:
        offset = _since_stamp_ns(values, finite_mask, unit.ns, stamp_ns, stamp_at)
    plausible_mask = finite_mask & (np.abs(offset) <= MAX_OFFSET_NS)
    kept = np.rint(np.where(plausible_mask, offset, 0.0)).astype(np.int32)
    spread = kept[plausible_mask]
    distinct = bool(spread.size and spread.min() != spread.max())
    return PointTime(kept, recorded=distinct and unit.fine_enough)


@dataclass(frozen=True, slots=True)
class _Unit:
    """Unit and origin of a time field.

    Attributes:
        ns: One unit, in nanoseconds.
        from_stamp: The numbers count from the cloud's stamp, not from the epoch or the like.
        fine_enough: The field's type resolves the points of a sweep in time.
    """

    ns: int
    from_stamp: bool
    fine_enough: bool


def _unit(name: str, finite: NDArray[Any]) -> _Unit:
    sample = finite[:: max(1, len(finite) // MAX_SAMPLE)]
    numbers = sample.astype(np.float64)
    typical = float(np.median(np.abs(numbers)))
    low, high = np.percentile(numbers, (2, 98))
    spread = float(high - low)
    floating = np.issubdtype(finite.dtype, np.floating)
    step = float(np.spacing(np.abs(sample).max())) if floating else 1.0
    fine_enough = spread >= LEAST_STEPS * step or len(finite) < LEAST_STEPS

    ns = _by_size(_SINCE_EPOCH_NS, typical)
    if ns is not None:
        return _Unit(ns, from_stamp=False, fine_enough=fine_enough)
    ns = next((ns for suffix, ns in _SUFFIX_NS.items() if name.endswith(suffix)), None)
    if ns is not None:
        return _Unit(ns, from_stamp=typical * ns <= MAX_OFFSET_NS, fine_enough=fine_enough)
    if not floating and (name in _NS_BY_CONVENTION or typical <= _WITHIN_SWEEP_NS[1][0]):
        return _Unit(1, from_stamp=True, fine_enough=fine_enough)
    if floating and typical > FAR_FROM_ZERO * spread and typical > _WITHIN_SWEEP_NS[2][0]:
        ns = _by_size(_WITHIN_SWEEP_NS, spread) or NS_PER_S
        return _Unit(ns, from_stamp=False, fine_enough=fine_enough)
    return _Unit(_by_size(_WITHIN_SWEEP_NS, typical) or NS_PER_S, True, fine_enough)


def _by_size(table: Sequence[tuple[float, int]], size: float) -> int | None:
    return next((ns for least, ns in table if size > least), None)


def _since_stamp_ns(
    values: NDArray[Any],
    finite_mask: NDArray[np.bool_],
    unit_ns: int,
    stamp_ns: int,
    stamp_at: StampAt,
) -> NDArray[np.float64]:
    """Subtract in the field's own type first: a float64 of nanoseconds would lose hundreds."""
    origin = values[finite_mask].min()
    after_origin: NDArray[np.float64] = (values - origin).astype(np.float64) * unit_ns
    if np.issubdtype(values.dtype, np.integer):
        origin_ns = int(origin) * unit_ns
    else:
        whole, part = divmod(float(origin), 1.0)
        origin_ns = int(whole) * unit_ns + round(part * unit_ns)
    shift_ns = origin_ns - stamp_ns
    if abs(shift_ns) <= MAX_OFFSET_NS:
        return np.add(after_origin, shift_ns)
    last = float(after_origin[finite_mask].max())
    return np.subtract(after_origin, {"start": 0.0, "middle": last / 2, "end": last}[stamp_at])
