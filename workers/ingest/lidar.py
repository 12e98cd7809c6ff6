"""Lidar selection: the topics of dense lidars, classified by their clouds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.ingest.frames import sensor_points
from workers.ingest.pointcloud import LABEL_FIELD, DecodedCloud

MIN_POINTS: Final = 800
"""Returns of a dense lidar at least; five automotive radars together have some 600."""

MIN_AZIMUTH_SHARE: Final = 0.7
"""Share of the azimuth with returns at least.

A spinning lidar sees all around but for a mast or a roof; cameras and forward lidars see a third.
"""

MIN_ELEVATION_SPAN_RAD: Final = np.deg2rad(5.0)
"""Span of elevation at least; single-plane scanners have none, the flattest spinning lidars 15
degrees."""

AZIMUTH_BINS: Final = 72
"""Bins of five degrees of azimuth: a cloud thinned to a thousand points still fills them."""

RADAR_FIELDS: Final = frozenset(
    {"rcs", "rcs_db", "radar_cross_section", "dyn_prop", "pdh0", "vx_comp", "snr", "snr_db"}
)
"""Fields that only radars record; FMCW lidars also have `velocity` and `doppler`."""

WORLD_FRAMES: Final = frozenset({"map", "odom", "world", "earth", "utm"})
"""Spaces (REP 105) that do not move with the sensor, as in maps and accumulated clouds."""


@dataclass(frozen=True, slots=True)
class LidarProperties:
    """Properties of a topic's sensor, from some of its clouds.

    Attributes:
        points: Median number of valid returns of the clouds that are not empty.
        azimuth_share: Median share of the circle around the sensor in which there are returns.
        elevation_span_rad: Median angle between the 2nd and the 98th percentile of elevation.
        frame_id: Space of the points, as the log names it.
        stamps_ns: Header stamps of the clouds.
        has_labels: Its points have the labels of a model.
        why_not: Why this is no lidar that is mined by default; empty if it is one.
    """

    points: int
    azimuth_share: float
    elevation_span_rad: float
    frame_id: str
    stamps_ns: tuple[int, ...]
    has_labels: bool
    why_not: str

    @property
    def is_lidar(self) -> bool:
        """True for a dense lidar that sees all around."""
        return not self.why_not


def lidar_properties(clouds: Sequence[DecodedCloud]) -> LidarProperties:
    """Classify the sensor of one topic by some of its clouds, from anywhere in the log.

    Args:
        clouds: Well-formed ones; empty ones count only if all are.
    """
    seen = [
        points_m[valid_mask]
        for points_m, valid_mask in map(sensor_points, filter(_has_positions, clouds))
        if valid_mask.any()
    ]
    points = int(np.median([len(points_m) for points_m in seen])) if seen else 0
    azimuth_share = float(np.median([_azimuth_share(points_m) for points_m in seen] or [0.0]))
    elevation_span_rad = float(np.median([_elevation_span_rad(p) for p in seen] or [0.0]))
    frame_id = clouds[0].frame_id if clouds else ""
    fields = {name.lower() for cloud in clouds for name in cloud.fields}
    return LidarProperties(
        points=points,
        azimuth_share=azimuth_share,
        elevation_span_rad=elevation_span_rad,
        frame_id=frame_id,
        stamps_ns=tuple(cloud.stamp_ns for cloud in clouds),
        has_labels=LABEL_FIELD in fields,
        why_not=_why_not(points, azimuth_share, elevation_span_rad, frame_id, fields),
    )


def choose_lidars(candidates: Mapping[str, LidarProperties]) -> list[str]:
    """Choose the topics to mine: every dense lidar that sees all around, once.

    A topic in the same space as a denser one, with a cloud of the very same stamp, is a filtered
    copy of it (without ground, or with labels). It would only repeat the contradictions.

    Returns:
        Topics, densest first, then by name.
    """
    lidars = sorted(
        (topic for topic, properties in candidates.items() if properties.is_lidar),
        key=lambda topic: (-candidates[topic].points, candidates[topic].has_labels, topic),
    )
    chosen: list[str] = []
    for topic in lidars:
        if not any(_copies(candidates[topic], candidates[denser]) for denser in chosen):
            chosen.append(topic)
    return chosen


def _has_positions(cloud: DecodedCloud) -> bool:
    return all(name in cloud.fields for name in "xyz")


def _copies(properties: LidarProperties, denser: LidarProperties) -> bool:
    shared = set(properties.stamps_ns) & set(denser.stamps_ns) - {0}
    return properties.frame_id == denser.frame_id and bool(shared)


def _why_not(
    points: int, azimuth_share: float, elevation_span_rad: float, frame_id: str, fields: set[str]
) -> str:
    """Name the first property that excludes a lidar, in words for the user."""
    if not points:
        return "its clouds hold no valid points"
    radar = sorted(fields & RADAR_FIELDS)
    if radar:
        return f"it is a radar's (field {radar[0]})"
    if frame_id.strip("/") in WORLD_FRAMES:
        return f"its points lie in {frame_id!r}, not in a sensor's own space"
    if points < MIN_POINTS:
        return f"its clouds have only {points} valid points"
    if azimuth_share < MIN_AZIMUTH_SHARE:
        return f"it sees only {360 * azimuth_share:.0f} degrees around"
    if elevation_span_rad < MIN_ELEVATION_SPAN_RAD:
        return f"it spans only {np.rad2deg(elevation_span_rad):.1f} degrees of elevation"
    return ""


def _azimuth_share(points_m: NDArray[np.float32]) -> float:
    azimuth_rad = np.arctan2(points_m[:, 1], points_m[:, 0])
    bins = ((azimuth_rad + np.pi) * (AZIMUTH_BINS / (2 * np.pi))).astype(np.int64) % AZIMUTH_BINS
    return float(np.count_nonzero(np.bincount(bins, minlength=AZIMUTH_BINS)) / AZIMUTH_BINS)


def _elevation_span_rad(points_m: NDArray[np.float32]) -> float:
    elevation_rad = np.arctan2(points_m[:, 2], np.hypot(points_m[:, 0], points_m[:, 1]))
    low, high = np.percentile(elevation_rad, (2, 98))
    return float(high - low)
