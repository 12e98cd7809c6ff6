"""Descriptors of scenes: what their contradicting tracks are, as unit vectors. Pure.

The inner product of two descriptors is their likeness, 0 to 1. A track is described by its kind,
its class, who errs, its length, height and speed, its distance, and its bearing in the sensor's
view. A scene is described by its listed tracks that are a reason, weighted by their strengths. The
statistics of its clouds describe its weather, where its record has them.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from schemas.attribution import Wrong
from schemas.contradiction import ContradictionKind
from schemas.events import TrackSummary
from schemas.surroundings import CloudStatistics
from service.curation.ranking import RankedScene, is_reason

Descriptors = NDArray[np.float32]
"""(N, `WIDTH`) unit vectors, none negative; zeros for a scene without a listed track. With weather
they have `WEATHER_WIDTH` more numbers.
"""

_UNKNOWN: Final = CloudStatistics(returns=0, range_m=0.0, airborne_share=0.0)

_KINDS: Final = {kind.value: number for number, kind in enumerate(ContradictionKind)}
_WRONGS: Final = {wrong: number for number, wrong in enumerate(Wrong)}
_KIND_BINS: Final = 8
"""The kinds of the task of motion, and five that other kinds share by their digest."""

_CLASS_BINS: Final = 71
"""Classes share these by their digest: two classes of one bin are taken for one."""

_BEARINGS: Final = 4


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Tracks as columns of one length M.

    Attributes:
        kind: Bin of the kind.
        class_name: Bin of the class.
        wrong: Number of the attribution; `len(Wrong)` without one.
        length_m: Length of the strongest instance, metres.
        height_m: Its height, metres.
        speed_m_per_s: Median speed over the ground; 0 unmeasured.
        range_m: Horizontal distance from the sensor, metres.
        bearing_rad: Direction in sensor space, from the x axis; NaN unknown.
    """

    kind: NDArray[np.int64]
    class_name: NDArray[np.int64]
    wrong: NDArray[np.int64]
    length_m: NDArray[np.float64]
    height_m: NDArray[np.float64]
    speed_m_per_s: NDArray[np.float64]
    range_m: NDArray[np.float64]
    bearing_rad: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Scale:
    """A quantity in soft bins of equal ratio.

    Attributes:
        weight: Share of the likeness.
        low: Centre of the first bin.
        high: Centre of the last bin.
        bins: Number of bins.
    """

    weight: float
    low: float
    high: float
    bins: int

    def of(self, values: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return (M, bins) unit vectors; neighbouring bins overlap."""
        at = np.log(np.clip(values, self.low, self.high) / self.low)
        at *= (self.bins - 1) / math.log(self.high / self.low)
        away = at[:, None] - np.arange(self.bins)
        return _unit(np.exp(-(away**2)).astype(np.float32))


_KIND_WEIGHT: Final = 0.25
_CLASS_WEIGHT: Final = 0.20
_WRONG_WEIGHT: Final = 0.10
_BEARING_WEIGHT: Final = 0.05
_LENGTH: Final = _Scale(0.10, 0.3, 12.0, 6)
_HEIGHT: Final = _Scale(0.10, 0.3, 4.0, 4)
_SPEED: Final = _Scale(0.10, 0.5, 25.0, 5)
_RANGE: Final = _Scale(0.10, 3.0, 100.0, 6)

WIDTH: Final = (
    _KIND_BINS
    + _CLASS_BINS
    + len(Wrong)
    + 1
    + _BEARINGS
    + sum(scale.bins for scale in (_LENGTH, _HEIGHT, _SPEED, _RANGE))
)
"""Numbers of a descriptor."""


WEATHER_WEIGHT: Final = 0.05
"""Share of the weather in the likeness of two scenes that both have it; as much as the bearing."""

_AIRBORNE: Final = _Scale(0.55, 1e-4, 2e-2, 5)
_INTENSITY: Final = _Scale(0.15, 0.01, 0.6, 4)
_MISSING: Final = _Scale(0.15, 0.02, 0.6, 4)
_NEAR: Final = _Scale(0.15, 4.0, 40.0, 4)
"""Weights within the weather. Only returns from the air separate rain from dry streets in measured
scenes; the others follow surfaces and sensors more than the weather.
"""

WEATHER_WIDTH: Final = sum(scale.bins for scale in (_AIRBORNE, _INTENSITY, _MISSING, _NEAR))
"""Numbers of the weather in a descriptor."""


def kind_bin(kind: str) -> int:
    """Return the bin of a kind of contradiction."""
    known = len(_KINDS)
    return _KINDS.get(kind, known + crc32(kind.encode()) % (_KIND_BINS - known))


def class_bin(class_name: str) -> int:
    """Return the bin of a semantic class; the first one is of no class."""
    return 1 + crc32(f"class {class_name}".encode()) % (_CLASS_BINS - 1) if class_name else 0


def columns_of(tracks: Sequence[TrackSummary]) -> Tracks:
    """Arrange listed tracks as columns."""
    return Tracks(
        kind=np.array([kind_bin(each.kind) for each in tracks], np.int64),
        class_name=np.array([class_bin(each.class_name) for each in tracks], np.int64),
        wrong=np.array(
            [len(Wrong) if each.wrong is None else _WRONGS[each.wrong] for each in tracks], np.int64
        ),
        length_m=np.array([each.size_m[0] for each in tracks], np.float64),
        height_m=np.array([each.size_m[2] for each in tracks], np.float64),
        speed_m_per_s=np.array([each.speed_m_per_s for each in tracks], np.float64),
        range_m=np.array([each.range_m for each in tracks], np.float64),
        bearing_rad=np.array(
            [math.atan2(each.centre_m[1], each.centre_m[0]) for each in tracks], np.float64
        ),
    )


def describe_tracks(tracks: Tracks) -> Descriptors:
    """Describe tracks: (M, `WIDTH`) unit vectors."""
    ahead = np.arange(_BEARINGS) * (2 * math.pi / _BEARINGS)
    known = np.nan_to_num(tracks.bearing_rad)[:, None]
    bearing = np.maximum(np.cos(known - ahead), 0.0)
    bearing = np.where(np.isnan(tracks.bearing_rad)[:, None], 1.0, bearing)
    blocks = (
        (_KIND_WEIGHT, np.eye(_KIND_BINS, dtype=np.float32)[tracks.kind]),
        (_CLASS_WEIGHT, np.eye(_CLASS_BINS, dtype=np.float32)[tracks.class_name]),
        (_WRONG_WEIGHT, np.eye(len(Wrong) + 1, dtype=np.float32)[tracks.wrong]),
        (_BEARING_WEIGHT, _unit(bearing.astype(np.float32))),
        (_LENGTH.weight, _LENGTH.of(tracks.length_m)),
        (_HEIGHT.weight, _HEIGHT.of(tracks.height_m)),
        (_SPEED.weight, _SPEED.of(tracks.speed_m_per_s)),
        (_RANGE.weight, _RANGE.of(tracks.range_m)),
    )
    return np.hstack([np.float32(math.sqrt(weight)) * block for weight, block in blocks])


def describe_scenes(
    tracks: Descriptors, scene: NDArray[np.int64], strength: NDArray[np.float64], *, count: int
) -> Descriptors:
    """Describe scenes by their tracks.

    Args:
        tracks: (M, `WIDTH`) descriptors of tracks.
        scene: (M,) number of the scene of each.
        strength: (M,) weight of each.
        count: Number of scenes.
    """
    found = np.zeros((count, WIDTH), np.float32)
    np.add.at(found, scene, tracks * strength[:, None].astype(np.float32))
    return _unit(found)


def describe(scenes: Iterable[RankedScene]) -> Descriptors:
    """Describe rows of the ranking by their listed tracks, those that are a reason where any is."""
    rows = [describing(scene) for scene in scenes]
    flat = [track for tracks in rows for track in tracks]
    number = np.repeat(np.arange(len(rows)), [len(tracks) for tracks in rows])
    strength = np.array([track.strength for track in flat], np.float64)
    return describe_scenes(describe_tracks(columns_of(flat)), number, strength, count=len(rows))


def describing(scene: RankedScene) -> tuple[TrackSummary, ...]:
    """Return the listed tracks that describe a scene: its reasons, else all."""
    reasons = tuple(each for each in scene.tracks if is_reason(each.strength, each.wrong))
    return reasons or scene.tracks


def with_weather(descriptors: Descriptors, clouds: Sequence[CloudStatistics | None]) -> Descriptors:
    """Add the weather to the descriptors of scenes.

    The likeness of two scenes without weather stays the same.

    Args:
        descriptors: (N, `WIDTH`) of the scenes.
        clouds: (N,) statistics of their clouds; None where a record has none.

    Returns:
        (N, `WIDTH` + `WEATHER_WIDTH`) vectors of the same length as before.
    """
    known = np.array([each is not None for each in clouds], np.bool_).reshape(-1, 1)
    share = np.where(known, np.float32(WEATHER_WEIGHT), np.float32(0.0))
    length = np.linalg.norm(descriptors, axis=1, keepdims=True)
    weather = _weather([each or _UNKNOWN for each in clouds])
    return np.hstack([np.sqrt(1 - share) * descriptors, np.sqrt(share) * length * weather])


def _weather(clouds: Sequence[CloudStatistics]) -> NDArray[np.float32]:
    """Describe the weather: (N, `WEATHER_WIDTH`) unit vectors."""
    columns = (
        (_AIRBORNE, [each.airborne_share for each in clouds]),
        (_INTENSITY, [each.intensity for each in clouds]),
        (_MISSING, [each.missing_share for each in clouds]),
        (_NEAR, [each.range_m for each in clouds]),
    )
    blocks = []
    for scale, values in columns:
        unknown = np.array([value is None for value in values], np.bool_)
        block = scale.of(np.array([value or 0.0 for value in values], np.float64))
        block[unknown] = math.sqrt(1.0 / scale.bins)
        blocks.append(np.float32(math.sqrt(scale.weight)) * block)
    return np.hstack(blocks)


def _unit(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    unit: NDArray[np.float32] = rows / np.maximum(length, np.float32(1e-12))
    return unit
