"""Simulation benchmark: frame rate, and statistics of simulated frames next to real ones."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.lab.simulation.output.write import write_log
from workers.lab.simulation.sensor.lidar import sweep
from workers.lab.simulation.sensor.sensors import SensorName, mounted
from workers.lab.simulation.world.street_builder import build_street
from workers.lab.simulation.world.street_kinds import PlaceName
from workers.lab.simulation.world.street_plan import StreetPlan

RANGES_M: Final = (0, 2, 5, 10, 15, 20, 30, 40, 60, 80, 120, 300)
ELEVATIONS_DEG: Final = (-90, -20, -16, -12, -10, -8, -6, -4, -2, 0, 2, 4, 8, 90)
FIRST_SEED: Final = 90_001
_SECONDS: Final = 6.0
_COLUMNS: Final = 1800
_LIKE: Final = 0.05
"""Largest range difference of one surface across a gap, as a share of the range."""


@dataclass(frozen=True, slots=True)
class Rate:
    """Time of one step on one core.

    Attributes:
        what: The step.
        ms: Processor time, milliseconds.
        per_s: Steps per second.
    """

    what: str
    ms: float
    per_s: float


@dataclass(frozen=True, slots=True, eq=False)
class SensorFrame:
    """One frame of a sensor, simulated or real.

    Attributes:
        points_m: (N, 3) sensor space.
        intensity: (N,) 0 to 1.
        ring: (N,) beam, 0 the top one; negative where the log does not record it.
    """

    points_m: NDArray[np.float32]
    intensity: NDArray[np.float32]
    ring: NDArray[np.int16]


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """Statistics of the frames of one sensor.

    Attributes:
        name: Source of the frames.
        points: Mean number of points.
        range_share: Share of the points in each interval of `RANGES_M`.
        elevation_share: Share of the points in each interval of `ELEVATIONS_DEG`.
        ring_share: Points of each beam over 1800; empty where beams are not known.
        single_gap_share: Share of empty range-image cells among cells between two neighbours on one
            surface; None where beams are not known.
        intensity: Tenth percentile, median and ninetieth percentile, 0 to 1.
    """

    name: str
    points: float
    range_share: tuple[float, ...]
    elevation_share: tuple[float, ...]
    ring_share: tuple[float, ...]
    single_gap_share: float | None
    intensity: tuple[float, float, float]


def bench_rates(*, frames: int, on_progress: Callable[[int, int], None]) -> list[Rate]:
    """Time a street, its frames, and a log of them with truth: 64 beams and 1800 columns."""
    lidar = mounted("pandar64", "roof")
    began = time.process_time()
    street = build_street(FIRST_SEED, seconds=frames * lidar.period_s)
    built = time.process_time()
    sweep(street, lidar, 0)
    indexed = time.process_time()
    for index in range(frames):
        sweep(street, lidar, index)
        on_progress(index + 1, 2 * frames)
    swept = time.process_time()
    done = [frames]

    def count() -> None:
        done[0] += 1
        on_progress(done[0], 2 * frames)

    with TemporaryDirectory() as folder:
        write_log(BytesIO(), street, lidar=lidar, truth=Path(folder), frames=1)  # compiles
        written = time.process_time()
        write_log(BytesIO(), street, lidar=lidar, truth=Path(folder), frames=frames, progress=count)
        ended = time.process_time()
    steps = (
        ("street construction, once per log", built - began, 1),
        ("beam directions, once per log", indexed - built, 1),
        ("frame, ray casting and sensor model", swept - indexed, frames),
        ("frame, written with its truth", ended - written, frames),
    )
    return [Rate(what, 1e3 * s / n, n / max(s, 1e-9)) for what, s, n in steps]


def statistics_of(name: str, frames: Sequence[SensorFrame]) -> FrameStatistics:
    """Compute the statistics of the frames of one sensor."""
    ringed = bool(len(frames)) and all((each.ring >= 0).all() for each in frames)
    ranges, elevations, rings, gaps, shines = [], [], [], [], []
    for each in frames:
        range_m = np.linalg.norm(each.points_m, axis=1)
        elevation = np.degrees(np.arcsin(each.points_m[:, 2] / np.maximum(range_m, 1e-3)))
        ranges.append(np.histogram(range_m, RANGES_M)[0] / len(range_m))
        elevations.append(np.histogram(elevation, ELEVATIONS_DEG)[0] / len(range_m))
        shines.append(np.quantile(each.intensity, (0.1, 0.5, 0.9)))
        if ringed:
            rings.append(np.bincount(each.ring, minlength=64) / _COLUMNS)
            gaps.append(_single_gaps(range_image(each)))
    low, median, high = np.mean(shines, axis=0).tolist()
    return FrameStatistics(
        name,
        float(np.mean([len(each.points_m) for each in frames])),
        _rounded(ranges),
        _rounded(elevations),
        _rounded(rings) if ringed else (),
        float(np.mean(gaps)) if ringed else None,
        (low, median, high),
    )


def simulated(sensor: SensorName, place: PlaceName, *, seed: int = FIRST_SEED) -> SensorFrame:
    """Simulate a frame in a street of this kind; an HDL-64 is on a mast, others are on a roof."""
    street = build_street(seed, seconds=_SECONDS, plan=StreetPlan(place=place, style="drives"))
    lidar = mounted(sensor, "mast" if sensor == "hdl64" else "roof")
    frame = sweep(street, replace(lidar, columns=_COLUMNS), 20)
    return SensorFrame(frame.points_m, frame.intensity / 255.0, frame.ring.astype(np.int16))


def simulated_statistics(
    sensor: SensorName,
) -> tuple[list[tuple[str, SensorFrame]], list[FrameStatistics]]:
    """Simulate two frames in each kind of street; return the first of each, and the statistics."""
    places: tuple[PlaceName, ...] = ("town", "suburb", "country", "highway")
    shown, statistics = [], []
    for place in places:
        name = f"simulated {sensor}, {place}"
        frames = [simulated(sensor, place, seed=FIRST_SEED + k) for k in range(2)]
        shown.append((name, frames[0]))
        statistics.append(statistics_of(name, frames))
    return shown, statistics


def range_image(seen: SensorFrame, *, rows: int = 64) -> NDArray[np.float32]:
    """Build (rows, 1800) ranges, 0 where empty: rows by beam, or by elevation without beams."""
    range_m = np.linalg.norm(seen.points_m, axis=1)
    azimuth = np.arctan2(seen.points_m[:, 1], seen.points_m[:, 0])
    column = np.round((np.pi - azimuth) / (2 * np.pi) * _COLUMNS).astype(np.int64) % _COLUMNS
    if (seen.ring >= 0).all():
        row = np.minimum(seen.ring.astype(np.int64), rows - 1)
    else:
        elevation = np.arcsin(seen.points_m[:, 2] / np.maximum(range_m, 1e-3))
        low, high = np.quantile(elevation, (0.001, 0.999))
        row = np.clip((high - elevation) / (high - low) * rows, 0, rows - 1).astype(np.int64)
    image = np.zeros((rows, _COLUMNS), dtype=np.float32)
    order = np.argsort(-range_m, kind="stable")
    image[row[order], column[order]] = range_m[order]
    return image


def _single_gaps(image: NDArray[np.float32]) -> float:
    """Return the share of single empty cells on surfaces.

    Where a sensor's azimuths do not match the grid of columns, some cells stay empty and their
    neighbours contain two points. Both kinds of frames share this effect, so a difference comes
    from the sensor.
    """
    left, middle, right = image[:, :-2], image[:, 1:-1], image[:, 2:]
    pair = (left > 0) & (right > 0) & (np.abs(left - right) < _LIKE * left)
    return float((pair & (middle == 0)).sum() / max(int(pair.sum()), 1))


def _rounded(shares: Sequence[NDArray[np.float64]]) -> tuple[float, ...]:
    return tuple(np.mean(shares, axis=0).round(4).tolist())
