"""Scans with normals for learned odometry, as DeLORA's published preprocessing makes them.

Source: Nubert, Khattak, Hutter, "Self-supervised Learning of LiDAR Odometry for Robotic
Applications", ICRA 2021, section III-C, and its code: normals by principal components of a patch of
the range image.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points, Transform
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from workers.lab.datasets.frame_files import (
    Numbered,
    chosen,
    made_once,
    street_clouds,
    stretch_frames,
)
from workers.lab.datasets.learnt_clouds import Stretch
from workers.lab.simulation.sensor.sensors import SensorName
from workers.lidar.range_image import SensorProfile, project
from workers.parts.registry import build_odometry

PATCH: Final = (7, 11)
"""Rows and columns of the patch of a normal, published."""

NEIGHBOUR_M: Final = 0.5
"""Largest difference in range of a neighbour to the centre, metres, published."""

FEWEST_NEIGHBOURS: Final = 10
"""Neighbours that a normal needs, published."""

FEWEST_POINTS: Final = 1000
"""Points with a normal that a scan needs."""

ROWS: Final = 64
PUBLISHED_COLUMNS: Final = 2250
COLUMNS: Final = 1024
"""Size of the image in which normals are found: as published, and otherwise a half."""

_EDGE_SHARE: Final = 0.001
"""Share of points above the upper edge of the measured field of view, and below the lower one."""


@dataclass(frozen=True, slots=True, eq=False)
class NormalScan:
    """Points of a range image with their normals.

    Attributes:
        points_m: (N, 3) float32, sensor space, metres.
        normals: (N, 3) float32 of length 1 towards the sensor; zero where there is none.
        fov_deg: Upper and lower edge of the scan, degrees.
        odom_from_sensor: (4, 4) pose by odometry, or of the simulation; the identity where the
            training needs none.
    """

    points_m: Points
    normals: NDArray[np.float32]
    fov_deg: tuple[float, float]
    odom_from_sensor: Transform

    @classmethod
    def of(
        cls, frame: LidarFrame, *, columns: int, odom_from_sensor: Transform | None = None
    ) -> "NormalScan | None":
        """Project a frame and find its normals; None where there are too few."""
        up, down = field_of_view(frame.points_m[frame.valid_mask])
        if up <= down:
            return None
        profile = SensorProfile(
            name="delora", rows=ROWS, columns=columns, fov_up_deg=up, fov_down_deg=down
        )
        image = project(frame.points_m, profile, valid_mask=frame.valid_mask)
        seen = image.seen_mask
        places = np.zeros((*seen.shape, 3), np.float32)
        places[seen] = frame.points_m[image.index[seen]]
        normals = patch_normals(places, seen)[seen]
        enough = np.count_nonzero(normals.any(axis=1)) >= FEWEST_POINTS
        pose = np.eye(4) if odom_from_sensor is None else odom_from_sensor
        return cls(places[seen], normals, (up, down), pose) if enough else None

    @classmethod
    def read(cls, path: Path) -> "NormalScan":
        """Read a scan that this file wrote."""
        with np.load(path) as stored:
            up, down = stored["fov_deg"].tolist()
            pose = stored["odom_from_sensor"]
            return cls(stored["points_m"], stored["normals"], (up, down), pose)

    def write(self, path: Path) -> None:
        """Write the scan to an `.npz` file."""
        np.savez(
            path,
            points_m=self.points_m,
            normals=self.normals,
            fov_deg=self.fov_deg,
            odom_from_sensor=self.odom_from_sensor,
        )


def field_of_view(points_m: Points) -> tuple[float, float]:
    """Return the upper and lower edge of a cloud, degrees, without a few stray points."""
    ranges = np.linalg.norm(points_m, axis=1)
    far = ranges > 0
    if not far.any():
        return 0.0, 0.0
    elevation = np.degrees(np.arcsin(points_m[far, 2] / ranges[far]))
    down, up = np.quantile(elevation, (_EDGE_SHARE, 1 - _EDGE_SHARE))
    return round(float(up), 2) + 0.01, round(float(down), 2) - 0.01


def patch_normals(places_m: NDArray[np.float32], seen: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the normal of each pixel by principal components of the patch around it.

    Args:
        places_m: (H, W, 3) points, metres.
        seen: (H, W) pixels with a point.

    Returns:
        (H, W, 3) of length 1 towards the sensor; zero without enough neighbours at its range.
    """
    rows, columns = seen.shape
    ranges = np.linalg.norm(places_m, axis=2)
    high, wide = PATCH[0] // 2, PATCH[1] // 2
    count = np.zeros((rows, columns))
    first = np.zeros((rows, columns, 3))
    second = np.zeros((rows, columns, 6))
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    for down in range(-high, high + 1):
        here, there = _overlap(rows, down)
        for right in range(-wide, wide + 1):
            other = np.roll(places_m[there], -right, axis=1)
            near = seen[here] & np.roll(seen[there], -right, axis=1)
            near &= np.abs(np.roll(ranges[there], -right, axis=1) - ranges[here]) < NEIGHBOUR_M
            apart = (other - places_m[here]) * near[..., None]
            count[here] += near
            first[here] += apart
            for place, (one, two) in enumerate(pairs):
                second[here][..., place] += apart[..., one] * apart[..., two]
    enough = seen & (count >= FEWEST_NEIGHBOURS)
    n, mean = count[enough][:, None], first[enough] / count[enough][:, None]
    spread = np.empty((len(n), 3, 3))
    for place, (one, two) in enumerate(pairs):
        value = second[enough][:, place] / n[:, 0] - mean[:, one] * mean[:, two]
        spread[:, one, two] = spread[:, two, one] = value
    normal = np.linalg.eigh(spread)[1][:, :, 0]
    away = (normal * places_m[enough]).sum(axis=1) > 0
    normal[away] *= -1
    normals = np.zeros((rows, columns, 3), np.float32)
    normals[enough] = normal
    return normals


def _overlap(rows: int, down: int) -> tuple[slice, slice]:
    """Return the rows that have a neighbour so many rows below, and those neighbours."""
    if down >= 0:
        return slice(0, rows - down), slice(down, rows)
    return slice(-down, rows), slice(0, rows + down)


def scans_of_stretch(
    folder: Path,
    bucket: Bucket,
    stretch: Stretch,
    settings: MiningSettings,
    *,
    columns: int,
    posed: bool,
    on_frame: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write the scans of a stretch of a log, or list those of an earlier run, in order of time.

    Args:
        folder: Folder of these scans alone.
        bucket: Bucket of the log.
        stretch: The stretch.
        settings: Ingest settings, and the odometry.
        columns: Columns of the image in which normals are found.
        posed: Pose the scans by that odometry; a scan whose pose is lost is left out.
        on_frame: Called with each frame.
    """

    def build() -> Numbered:
        frames = stretch_frames(bucket, stretch, settings)
        known = (
            build_odometry(settings.odometry)(frames)
            if posed
            else (PosedFrame(frame, np.eye(4)) for frame in frames)
        )
        for number, each in chosen(known, stretch, on_frame):
            lost = each.odometry is OdometryState.LOST
            pose = each.odom_from_sensor
            yield (
                number,
                None if lost else NormalScan.of(each.frame, columns=columns, odom_from_sensor=pose),
            )

    return made_once(folder, build)


def scans_of_streets(
    folder: Path,
    *,
    streets: int,
    sensors: Sequence[SensorName],
    seed: int,
    columns: int,
    firings: int | None = None,
    on_window: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write scans of simulated streets, or list those of an earlier run.

    Args:
        folder: Folder of these scans alone.
        streets: Number of streets.
        sensors: Sensors to draw from.
        seed: Seed of the streets.
        columns: Columns of the image in which normals are found.
        firings: Firings per turn; None: as the sensor has.
        on_window: Called with each sample of a street.
    """

    def build() -> Numbered:
        for first, clouds in street_clouds(
            streets=streets, sensors=sensors, seed=seed, columns=firings, on_window=on_window
        ):
            for number, cloud in enumerate(clouds, start=first):
                yield (
                    number,
                    NormalScan.of(
                        cloud.frame, columns=columns, odom_from_sensor=cloud.world_from_sensor
                    ),
                )

    return made_once(folder, build) if streets else []
