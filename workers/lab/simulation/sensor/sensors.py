"""Sensor catalogue: beam tables of common lidars, and their mountings."""

from dataclasses import replace
from typing import Final, Literal

import numpy as np

from workers.lab.simulation.sensor.lidar import UNEVEN_64, Lidar

SensorName = Literal["pandar64", "hdl64", "hdl64-compensated", "hdl32", "vlp32c", "os1-128"]
MountingName = Literal["roof", "mast", "rack"]

_HDL64: Final = Lidar(
    name="hdl64",
    elevation_deg=(
        *np.linspace(2.0, -8.33, 32).round(3).tolist(),
        *np.linspace(-8.83, -24.33, 32).round(3).tolist(),
    ),
    columns=1800,
    max_range_m=120.0,
    reach_m=110.0,
    noise_m=0.02,
    gain=240.0,
    gamma=0.35,
    least_range_m=0.9,
)
_VLP32C: Final = (
    *(15.0, 10.333, 7.0, 4.667, 3.333, 2.333, 1.667, 1.333, 1.0, 0.667, 0.333, 0.0),
    *(-0.333, -0.667, -1.0, -1.333, -1.667, -2.0, -2.333, -2.667, -3.0, -3.333, -3.667, -4.0),
    *(-4.667, -5.333, -6.148, -7.254, -8.843, -11.31, -15.639, -25.0),
)
_PANDAR64_TURNS: Final = (-1.042, 1.042, 3.125, 5.208, -1.042, -3.125, -5.208)
_VLP32C_TURNS: Final = (1.4, -4.2, 1.4, -1.4, 4.2, -1.4, 1.4, -1.4)

SENSORS: Final[dict[SensorName, Lidar]] = {
    "pandar64": Lidar(
        name="pandar64",
        elevation_deg=UNEVEN_64,
        azimuth_deg=tuple(
            _PANDAR64_TURNS[(k - 6) % 6 + 1] if 6 <= k < 54 else _PANDAR64_TURNS[0]
            for k in range(64)
        ),
        columns=1800,
        max_range_m=200.0,
        reach_m=200.0,
        noise_m=0.02,
        roof_answers=0.5,
        gain=65.0,
    ),
    "hdl64": _HDL64,
    "hdl64-compensated": replace(_HDL64, name="hdl64-compensated", columns=2000, compensated=True),
    "hdl32": Lidar(
        name="hdl32",
        elevation_deg=tuple(np.linspace(10.67, -30.67, 32).round(3).tolist()),
        columns=1800,
        max_range_m=100.0,
        reach_m=90.0,
        gain=100.0,
        gamma=0.5,
        noise_m=0.02,
        least_range_m=0.9,
    ),
    "vlp32c": Lidar(
        name="vlp32c",
        elevation_deg=_VLP32C,
        azimuth_deg=tuple(_VLP32C_TURNS[k % 8] for k in range(32)),
        columns=1800,
        max_range_m=200.0,
        reach_m=180.0,
        gain=110.0,
        gamma=0.6,
        noise_m=0.03,
        least_range_m=0.9,
    ),
    "os1-128": Lidar(
        name="os1-128",
        elevation_deg=tuple(np.linspace(22.5, -22.5, 128).round(3).tolist()),
        columns=1024,
        max_range_m=120.0,
        reach_m=110.0,
        noise_m=0.015,
        gain=180.0,
        gamma=0.8,
        least_range_m=0.5,
    ),
}
"""Lidars by name: beam tables from the manufacturers' manuals, azimuth offsets of similar size.

Range of a 64 x 1800 or 32 x 1800 sensor at 10 Hz; the sensor of 128 beams fires 1024 columns.
`hdl64-compensated` records as data sets such as KITTI do: 2000 columns, clouds compensated to the
stamp, and neither a time nor a beam per point.
"""

_MOUNTINGS: Final[dict[MountingName, tuple[float, float, float, bool]]] = {
    "roof": (1.75, 0.2, 0.4, True),
    "mast": (2.25, 0.75, -0.9, True),
    "rack": (1.73, 0.0, 0.0, False),
}
"""Height, offset ahead of the middle of the car, nose-down tilt in degrees, whether the car hides
the lowest beams."""


def usual_mounting(sensor: SensorName) -> MountingName:
    """Return the mounting of a sensor on all cars of a fleet: free of the car if compensated."""
    return "rack" if SENSORS[sensor].compensated else "roof"


def mounted(sensor: SensorName, mounting: MountingName, *, columns: int | None = None) -> Lidar:
    """Mount a sensor on a car; fewer columns make logs small and fast."""
    lidar, (height, forward, pitch, roof) = SENSORS[sensor], _MOUNTINGS[mounting]
    return replace(
        lidar,
        columns=columns or lidar.columns,
        height_m=height,
        forward_m=forward,
        pitch_deg=pitch,
        roof=roof,
        name=f"{sensor} on a {mounting}",
    )


def further_lidars(lidar: Lidar, count: int) -> tuple[Lidar, ...]:
    """Mount near-field lidars on the bumpers and sides of a car: front, rear, left, right.

    They have the period of the main lidar, and fire some milliseconds after it.

    Args:
        lidar: The main lidar.
        count: Number of further ones, 4 at most.
    """
    columns = max(64, lidar.columns * 2 // 5)
    return tuple(
        replace(
            _NEAR_FIELD,
            columns=columns,
            period_s=lidar.period_s,
            forward_m=forward_m,
            left_m=left_m,
            yaw_deg=yaw_deg,
            phase_s=lidar.period_s * 0.4 + 0.005 * number,
            number=number + 1,
            name=f"near-field lidar, {NEAR_FIELD_PLACES[number]}",
        )
        for number, (forward_m, left_m, yaw_deg) in enumerate(_PLACES[:count])
    )


NEAR_FIELD_PLACES: Final = ("front", "rear", "left", "right")
_PLACES: Final = ((2.4, 0.0, 0.0), (-2.4, 0.0, 180.0), (0.6, 0.95, 90.0), (0.6, -0.95, -90.0))

_NEAR_FIELD: Final = Lidar(
    elevation_deg=tuple(np.linspace(15.0, -31.5, 32).round(3).tolist()),
    height_m=0.65,
    fov_deg=144.0,
    max_range_m=60.0,
    reach_m=40.0,
    gain=140.0,
    gamma=0.5,
    noise_m=0.02,
    least_range_m=0.3,
)
"""A lidar of 32 beams and 144 degrees that sees what is close to the car."""
