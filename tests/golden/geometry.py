"""Checks of range images, residual images, pillars and filters."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from schemas.arrays import Points
from tests.golden.difference import Difference, near, same
from tests.golden.files import arrays, document, number_of
from workers.geometry.range_image import SensorProfile, image_channels, project
from workers.geometry.se3 import inverse, transform
from workers.supervised.postprocess import KnnSettings, find_voters
from workers.supervised.residual_image import ResidualSettings, residual_image

KITTI360 = SensorProfile(
    name="kitti360",
    rows=64,
    columns=2048,
    fov_up_deg=3,
    fov_down_deg=-25,
    clamp=True,
    means=(11.27, -0.01, 0.27, -1.01, 0.30),
    stds=(9.70, 12.14, 8.48, 0.84, 0.15),
)
MOVED_PIXELS = 4
"""The last bit of arctan2 and arcsin depends on the processor."""
ROUNDED_PIXELS = 20
"""Of a residual image: rounding along the chain of poses."""


def check_range_projection(folder: Path, file: Path) -> list[Difference]:
    """Compare which point each pixel shows, and the normalised input of the network."""
    del folder
    golden = arrays(file)
    points = golden["points"]
    image = project(points[:, :3], KITTI360)
    expected = golden["proj_idx"].copy()
    ambiguous = tuple(golden["ambiguous_pixels_row_col"].T.astype(int))
    expected[ambiguous] = image.index[ambiguous]
    alike = image.index == expected
    found = [
        same("proj_idx", image.index, expected, allowed=MOVED_PIXELS),
        near("proj_range", image.range_m[alike], golden["proj_range"][alike], tolerance=1e-5),
    ]
    if "network_input" in golden:
        channels = image_channels(image, points[:, :3], points[:, 3], KITTI360)
        alike &= image.index != 0
        found.append(
            near(
                "network_input",
                channels[:, alike],
                golden["network_input"][:, alike],
                tolerance=1e-5,
            )
        )
    return found


def check_knn(folder: Path, file: Path) -> list[Difference]:
    """Compare the classes that points get back from the image."""
    golden = arrays(file)
    points = _points(folder, number_of(file))
    image = project(points, KITTI360)
    classes = golden["argmax_image"]
    found = find_voters(image, [classes], KnnSettings(wrap=False)).vote(classes)
    return [same("knn_labels", np.where(found == 0, 1, found), golden["knn_labels"])]


def check_residuals(folder: Path, file: Path) -> list[Difference]:
    """Compare the residual images of the frames of the folder."""
    golden, frames = arrays(file), document(folder / "geometry" / "calibration.json")["frames"]
    poses = arrays(folder / "geometry" / "poses.npz")["lidar_to_world"]
    points = [_points(folder, number) for number in frames]
    found = []
    for name, expected in golden.items():
        age, _, frame = name.removeprefix("k").partition("_frame")
        now, past = int(frame), int(frame) - int(age)
        moved = transform(inverse(poses[now]) @ poses[past], points[past])
        residuals = residual_image(
            project(points[now], KITTI360, gate_m=(2, 50)), moved, KITTI360, ResidualSettings()
        )
        apart = np.abs(residuals - expected) > 1e-5
        found.append(same(name, apart, np.zeros_like(apart), allowed=ROUNDED_PIXELS))
    return found


def _points(folder: Path, number: int) -> Points:
    return arrays(folder / "geometry" / f"range_projection_{number:06d}.npz")["points"][:, :3]


CHECKS: Final[Mapping[str, Callable[[Path, Path], list[Difference]]]] = {
    "geometry/range_projection_*.npz": check_range_projection,
    "geometry/knn_*.npz": check_knn,
    "geometry/residual_images.npz": check_residuals,
}
