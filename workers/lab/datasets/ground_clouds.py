"""Clouds with the ground that Counterpoint finds in them, kept in the work folder of a run."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import griddata

from schemas.arrays import Mask, Points
from schemas.frame import LidarFrame
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from workers.lab.datasets.frame_files import Numbered, made_once, stretch_frames
from workers.lab.datasets.learnt_clouds import Stretch
from workers.lab.datasets.simulated import clouds_of
from workers.lab.simulation.output.samples import street_samples
from workers.lab.simulation.sensor.sensors import SensorName
from workers.lidar.ground import ground_mask
from workers.lidar.sensor_height import estimate_sensor_height
from workers.paper.pillars import GNDNET_GRID

LABELS: Final = "ground of Patchwork++ with the height guard"
"""Source of the labels, for request and card."""

FEWEST_CELLS: Final = 50
"""Cells with ground that a cloud needs; a surface through fewer says little of 10,000."""

_NEAR_M: Final = 60.0
"""Largest |x| and |y| of points that are kept, metres: the map, and what a tilt moves into it."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundCloud:
    """Points of one cloud, with its ground.

    Attributes:
        points_m: (N, 3) float32 valid points near the sensor, sensor space, metres.
        intensity: (N,) float32, 0 to 1.
        ground: (N,) points on the ground.
        sensor_height_m: Estimated height of the sensor over the road.
    """

    points_m: Points
    intensity: NDArray[np.float32]
    ground: Mask
    sensor_height_m: float

    @classmethod
    def of(cls, frame: LidarFrame) -> "GroundCloud | None":
        """Find the ground of a frame; None where too little of it is seen."""
        points = frame.points_m[frame.valid_mask]
        height_m = estimate_sensor_height(points)
        ground = ground_mask(points, sensor_height_m=height_m)
        near = (np.abs(points[:, :2]) < _NEAR_M).all(axis=1)
        cloud = cls(points[near], frame.intensity[frame.valid_mask][near], ground[near], height_m)
        seen = np.isfinite(cell_heights(cloud.points_m[cloud.ground])).sum()
        return cloud if seen >= FEWEST_CELLS else None

    @classmethod
    def read(cls, path: Path) -> "GroundCloud":
        """Read a cloud that this file wrote."""
        with np.load(path) as stored:
            return cls(
                stored["points_m"],
                stored["intensity"],
                stored["ground"],
                float(stored["sensor_height_m"]),
            )

    def write(self, path: Path) -> None:
        """Write the cloud to an `.npz` file."""
        np.savez(
            path,
            points_m=self.points_m,
            intensity=self.intensity,
            ground=self.ground,
            sensor_height_m=self.sensor_height_m,
        )


def cell_heights(ground_m: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return the median height of ground points in each cell of GndNet's map.

    Args:
        ground_m: (G, 3) ground points, metres.

    Returns:
        (100, 100) metres, rows by y; NaN where there is no point.
    """
    grid = GNDNET_GRID
    rows, columns = grid.shape
    heights = np.full(rows * columns, np.nan, np.float32)
    column = np.floor((ground_m[:, 0] - grid.x_m[0]) / grid.side_m).astype(np.intp)
    row = np.floor((ground_m[:, 1] - grid.y_m[0]) / grid.side_m).astype(np.intp)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    cell, z_m = (row * columns + column)[inside], ground_m[inside, 2]
    order = np.lexsort((z_m, cell))
    found, first, count = np.unique(cell[order], return_index=True, return_counts=True)
    heights[found] = z_m[order][first + (count - 1) // 2]
    return heights.reshape(rows, columns)


def filled(heights_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Fill cells without ground: linearly between cells with ground, else as the nearest one.

    Args:
        heights_m: (100, 100) metres, NaN where unknown; at least one is known.

    Returns:
        (100, 100) without NaN.
    """
    known = np.argwhere(np.isfinite(heights_m))
    values, everywhere = heights_m[tuple(known.T)], np.argwhere(np.ones_like(heights_m, np.bool_))
    flat = np.linalg.matrix_rank(known - known[0]) < 2  # cells in a line have no triangles
    answer = np.full(len(everywhere), np.nan) if flat else griddata(known, values, everywhere)
    nearest = griddata(known, values, everywhere, method="nearest")
    whole = np.where(np.isfinite(answer), answer, nearest).astype(np.float32)
    return whole.reshape(heights_m.shape)


def clouds_of_stretch(
    folder: Path,
    bucket: Bucket,
    stretch: Stretch,
    settings: MiningSettings,
    *,
    every: int = 1,
    on_frame: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write the clouds of a stretch of a log, or list those of an earlier run, in order of time.

    Args:
        folder: Folder of these clouds alone.
        bucket: Bucket of the log.
        stretch: The stretch.
        settings: Ingest settings.
        every: One frame of so many is taken.
        on_frame: Called with each frame.
    """
    shard = stretch.shard

    def build() -> Numbered:
        number = 0
        for frame in stretch_frames(bucket, stretch, settings):
            if not shard.start_ns <= frame.stamp_ns < shard.end_ns:
                continue
            if number >= stretch.frames.stop:
                return
            if number in stretch.frames and number % every == 0:
                on_frame()
                yield number, GroundCloud.of(frame)
            number += 1

    return made_once(folder, build)


def clouds_of_streets(
    folder: Path,
    *,
    streets: int,
    sensors: Sequence[SensorName],
    seed: int,
    columns: int | None = None,
    on_window: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write clouds of simulated streets, four of each, or list those of an earlier run."""

    def build() -> Numbered:
        number = 0
        drawn = street_samples(seed, streets=streets, frames=3, sensors=sensors, columns=columns)
        for sample in drawn:
            for cloud in clouds_of(sample):
                yield number, GroundCloud.of(cloud.frame)
                number += 1
            on_window()

    return made_once(folder, build) if streets else []
