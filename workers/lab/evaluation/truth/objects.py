"""True moving objects of a log: class, size, speed and velocity per frame."""

import csv
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

SPEEDS_M_PER_S: Final = (2.0, 5.0, 10.0)
"""Edges of the speed bins, m/s: pedestrian, cyclist or turning car, car in town, faster car."""

SIZES_M: Final = (1.5, 3.0, 6.0)
"""Edges of the size bins, metres: longest side of a person, of a two-wheeler, of a car."""

POINTS: Final = (20, 50, 100, 300)


@dataclass(frozen=True, slots=True, eq=False)
class TrueObject:
    """One object in one frame, as far as truth describes it.

    Attributes:
        class_name: True class; `unknown` where truth has none.
        speed_m_per_s: Speed over the ground; None where not known.
        longest_side_m: Longest side of its box; None where not known.
        velocity_m_per_s: (3,) over the ground, world space of the truth's poses.
    """

    class_name: str = "unknown"
    speed_m_per_s: float | None = None
    longest_side_m: float | None = None
    velocity_m_per_s: NDArray[np.float64] | None = None

    def kinds(self, points: int) -> Iterator[tuple[str, str]]:
        """Yield each dimension of the breakdown and its bin: class, speed, size, points."""
        yield "class", self.class_name
        if self.speed_m_per_s is not None:
            yield "speed", _step(self.speed_m_per_s, SPEEDS_M_PER_S)
        if self.longest_side_m is not None:
            yield "size", _step(self.longest_side_m, SIZES_M)
        yield "points", _step(points, POINTS)


Objects = Mapping[int, TrueObject]
"""The objects of one frame by track id."""


def objects_in(folder: Path) -> dict[int, dict[int, TrueObject]]:
    """Read the objects of one part of a log from its `tracks.csv`, by frame and track id.

    Returns:
        Objects by frame and track id; empty without such a table. Missing columns stay unknown.
    """
    table = folder / "tracks.csv"
    if not table.is_file():
        return {}
    frames: dict[int, dict[int, TrueObject]] = {}
    with table.open(newline="") as file:
        for row in csv.DictReader(file):
            frames.setdefault(int(row["frame"]), {})[int(row["track_id"])] = _object(row)
    return frames


def rotations_in(folder: Path) -> dict[int, NDArray[np.float64]]:
    """Read the true attitude of the sensor, (3, 3) world from sensor, by stamp in nanoseconds.

    Poses without truth (`poses_icp.npz`) are in another world space and are not read.
    """
    file = folder / "poses.npz"
    if not file.is_file():
        return {}
    with np.load(file) as arrays:
        stamps, poses = arrays["stamp_ns"], arrays["world_from_lidar_at_stamp"]
    return {int(stamp): pose[:3, :3] for stamp, pose in zip(stamps, poses, strict=True)}


def _object(row: Mapping[str, str]) -> TrueObject:
    def number(name: str) -> float | None:
        return float(row[name]) if row.get(name) else None

    vx, vy = number("vx"), number("vy")
    speed = number("speed")
    if speed is None and vx is not None and vy is not None:
        speed = float(np.hypot(vx, vy))
    sides = [side for name in ("length", "width", "height") if (side := number(name)) is not None]
    velocity = None
    if vx is not None and vy is not None:
        velocity = np.array([vx, vy, number("vz") or 0.0])
    return TrueObject(row.get("class") or "unknown", speed, max(sides, default=None), velocity)


def _step(value: float, edges: tuple[float, ...]) -> str:
    """Name the bin of a value: `0-2`, `2-5`, `10-`."""
    place = int(np.searchsorted(edges, value, side="right"))
    low = edges[place - 1] if place else 0
    return f"{low:g}-{edges[place]:g}" if place < len(edges) else f"{low:g}-"
