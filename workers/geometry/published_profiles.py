"""The range images that the published networks were trained on."""

from dataclasses import replace
from typing import Final

from workers.geometry.range_image import SensorProfile

KITTI360: Final = SensorProfile(
    name="kitti360",
    rows=64,
    columns=2048,
    fov_up_deg=3,
    fov_down_deg=-25,
    means=(11.27, -0.01, 0.27, -1.01, 0.30),
    stds=(9.70, 12.14, 8.48, 0.84, 0.15),
)
"""HDL-64 as SalsaNext and LMNet of the paper saw it; means and deviations of KITTI-360."""

SEMANTIC_KITTI: Final = replace(
    KITTI360,
    name="semantickitti",
    means=(12.12, 10.88, 0.23, -1.04, 0.21),
    stds=(12.32, 11.47, 6.91, 0.86, 0.16),
)
"""As SalsaNext of SemanticKITTI saw it; the mean of x is wrong, but the network learnt with it."""
