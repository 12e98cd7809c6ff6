"""Poses of KITTI's GPS and IMU: latitude, longitude, height and angles per scan."""

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from schemas.arrays import Transform
from workers.lab.datasets.conversion.source import DatasetUnusableError
from workers.lab.datasets.published.files import read_text

EARTH_M: Final = 6_378_137.0
"""Radius of the Mercator projection, metres, as in KITTI's development kit."""

LEAST_VALUES: Final = 6


def read_oxts(folder: Path, numbers: Iterable[int]) -> dict[int, Transform]:
    """Read the poses of the IMU, (4, 4) world from IMU; the world begins at the first one.

    The world is Mercator's at the latitude of the first pose, x east, y north, z up.

    Raises:
        DatasetUnusableError: If a file is missing or has fewer than six finite numbers.
    """
    poses: dict[int, Transform] = {}
    scale, origin = 0.0, np.zeros(3)
    for number in numbers:
        path = folder / f"{number:010d}.txt"
        try:
            values = [float(each) for each in read_text(path).split()]
        except ValueError:
            values = []
        if len(values) < LEAST_VALUES or not np.isfinite(values[:LEAST_VALUES]).all():
            raise DatasetUnusableError(f"no latitude, longitude, height and angles in {path}")
        latitude, longitude, height, roll, pitch, yaw = values[:LEAST_VALUES]
        first = not poses
        if first:
            scale = float(np.cos(np.radians(latitude)))
        place = np.array(
            [
                scale * EARTH_M * np.radians(longitude),
                scale * EARTH_M * np.log(np.tan(np.pi / 4 + np.radians(latitude) / 2)),
                height,
            ]
        )
        if first:
            origin = place
        pose: Transform = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        pose[:3, 3] = place - origin
        poses[number] = pose
    return poses
