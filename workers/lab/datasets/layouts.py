"""Layouts of training images: rows as the sensor's beams, residuals of the last second."""

from typing import Final

from workers.lidar.range_image import SensorProfile
from workers.supervised.residual_image import ResidualSettings

PROFILE: Final = SensorProfile(
    name="any spinning lidar",
    rows=64,
    columns=512,
    fov_up_deg=15.0,
    fov_down_deg=-25.0,
    fitted=True,
)
"""Layout of the images; the number of rows is that of each sensor."""

RESIDUAL: Final = ResidualSettings(
    ages_s=(0.1, 0.2, 0.3, 0.5, 0.8), min_range_m=2.0, max_range_m=100.0
)
"""Ages of the residual images: short for fast objects, long for slow ones, within the warm-up."""
