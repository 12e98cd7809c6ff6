"""Frames from decoded clouds: one time base, one unit and one meaning for the drivers' fields."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from schemas.camera import CameraCalibration
from schemas.frame import Compensated, LidarFrame, RecordedLabels, StampAt
from workers.errors import CloudUnreadableError
from workers.ingest.point_time import point_time
from workers.ingest.pointcloud import DecodedCloud

INTENSITY_FIELDS: Final = ("intensity", "i", "reflectivity", "reflectance", "remission", "signal")
"""Intensity fields in order of preference; the first in a cloud counts."""

RING_FIELDS: Final = ("ring", "laser_number", "laser_id", "channel", "line", "beam")
"""Beam fields in order of preference: ROS and Ouster, Argoverse 2, converters, Autoware, Livox."""

MAX_COORDINATE_M: Final = 10_000.0
"""Coordinate beyond which a point is no return, metres; its square would overflow a float32."""

INTENSITY_SCALES: Final = (1.0, 255.0, 4095.0, 65535.0)
"""Full scale of normalised floats and of 8, 12 and 16 bits, the widths that sensors record."""


@np.errstate(over="ignore", invalid="ignore")  # clouds contain odd numbers
def frame_from_cloud(
    cloud: DecodedCloud,
    *,
    log_id: str,
    log_time_ns: int,
    previous_stamp_ns: int | None,
    intensity_scale: float,
    stamp_at: StampAt,
    compensated: Compensated = "auto",
    recorded: RecordedLabels | None = None,
    camera: CameraCalibration | None = None,
) -> LidarFrame:
    """Make the frame of a cloud; point i of the message is point i of the frame.

    Args:
        cloud: As decoded.
        log_id: The recording.
        log_time_ns: Log time of the message.
        previous_stamp_ns: Stamp of the frame before, None where there is none.
        intensity_scale: Recorded value that means 1.
        stamp_at: Instant of the sweep that the header's stamp refers to.
        compensated: Whether the car's motion was removed before the cloud was recorded.
        recorded: The labels of the model that ran on the car, if the log contains them.
        camera: The camera whose view is compared, if one is wanted.

    Raises:
        CloudUnreadableError: If the cloud has points, but no x, y or z.
        ValueError: If the recorded labels are not as many as the points.
    """
    stamp_ns = frame_stamp_ns(
        cloud.stamp_ns, log_time_ns=log_time_ns, previous_stamp_ns=previous_stamp_ns
    )
    points_m, valid_mask = sensor_points(cloud)
    times = point_time(cloud.fields, points=len(cloud), stamp_ns=stamp_ns, stamp_at=stamp_at)
    return LidarFrame(
        log_id=log_id,
        stamp_ns=stamp_ns,
        points_m=points_m,
        intensity=_intensity(cloud, intensity_scale),
        offset_ns=times.offset_ns,
        ring=_ring(cloud),
        valid_mask=valid_mask,
        has_point_time=times.recorded,
        stamp_at=stamp_at,
        compensated=compensated,
        recorded=recorded,
        camera=camera,
    )


def frame_stamp_ns(header_ns: int, *, log_time_ns: int, previous_stamp_ns: int | None) -> int:
    """Choose the time of a frame: its header's, or its log time where that does not rise.

    Where log time does not rise either, as when a message was recorded twice, the later of the two
    is used: a repeated or falling stamp signals to later stages that time did not pass.
    """
    floor_ns = 0 if previous_stamp_ns is None else previous_stamp_ns
    if header_ns > floor_ns:
        return header_ns
    if log_time_ns > floor_ns:
        return log_time_ns
    return max(header_ns, log_time_ns)


@np.errstate(over="ignore", invalid="ignore")  # clouds contain odd numbers
def intensity_scale_of(clouds: Sequence[DecodedCloud]) -> float:
    """Estimate, from some clouds of a lidar, which recorded intensity means 1.

    It is the smallest full scale over 99 of 100 returns. Normalised floats stay below 1.5, and a
    few saturated returns must not make a log of bytes look like one of words. Bytes are always 255
    wide; wider integers are judged by their values, since drivers put bytes into uint16.

    Returns:
        One of `INTENSITY_SCALES`; 1 where nothing was recorded.
    """
    found = [values for cloud in clouds if (values := _first(cloud, INTENSITY_FIELDS)) is not None]
    if any(values.dtype == np.uint8 for values in found):
        return 255.0
    finite = [values[np.isfinite(values)].astype(np.float64) for values in found if values.size > 0]
    values = np.concatenate(finite) if finite else np.empty(0)
    if not values.size:
        return 1.0
    typical_maximum = float(np.percentile(values, 99))
    if typical_maximum <= 1.5 and not any(np.issubdtype(f.dtype, np.integer) for f in found):
        return 1.0
    return next(
        (scale for scale in INTENSITY_SCALES[1:] if typical_maximum <= scale), INTENSITY_SCALES[-1]
    )


def _first(cloud: DecodedCloud, names: Sequence[str]) -> NDArray[Any] | None:
    fields: Mapping[str, NDArray[Any]] = cloud.fields
    return next((fields[name] for name in names if name in fields and fields[name].ndim == 1), None)


@np.errstate(over="ignore", invalid="ignore")  # clouds contain odd numbers
def sensor_points(cloud: DecodedCloud) -> tuple[Points, Mask]:
    """Read positions, and the mask of returns.

    Returns:
        (N, 3) metres, sensor space, zero where there is no return, and (N,) true where there is
        one: finite, not zero, within the reach of a lidar.

    Raises:
        CloudUnreadableError: If the cloud has points, but no x, y or z.
    """
    points_m = np.zeros((len(cloud), 3), dtype=np.float32)
    if not len(cloud):
        return points_m, np.zeros(0, dtype=np.bool_)
    missing = [name for name in "xyz" if name not in cloud.fields]
    if missing:
        raise CloudUnreadableError(
            f"cannot read cloud: no field {', '.join(missing)}; fields are "
            f"{', '.join(sorted(cloud.fields))} (stamp {cloud.stamp_ns})"
        )
    axes = [_single(cloud.fields[name]).astype(np.float32) for name in "xyz"]
    inside = [np.abs(axis) <= MAX_COORDINATE_M for axis in axes]
    away = [axis != 0 for axis in axes]
    valid_mask = (inside[0] & inside[1] & inside[2]) & (away[0] | away[1] | away[2])
    for column, axis in enumerate(axes):
        np.copyto(points_m[:, column], axis, where=valid_mask)
    return points_m, valid_mask


def _single(values: NDArray[Any]) -> NDArray[Any]:
    return values if values.ndim == 1 else values[:, 0]


def _intensity(cloud: DecodedCloud, scale: float) -> NDArray[np.float32]:
    values = _first(cloud, INTENSITY_FIELDS)
    if values is None:
        return np.zeros(len(cloud), dtype=np.float32)
    scaled = values.astype(np.float32) / np.float32(scale)
    finite: NDArray[np.float32] = np.nan_to_num(scaled, nan=0.0, posinf=1.0, neginf=0.0)
    return finite.clip(0.0, 1.0)


def _ring(cloud: DecodedCloud) -> NDArray[np.int16]:
    values = _first(cloud, RING_FIELDS)
    if values is None:
        return np.full(len(cloud), -1, dtype=np.int16)
    beam = values.astype(np.float64)
    known_mask = (beam >= 0) & (beam <= np.iinfo(np.int16).max)
    return np.where(known_mask, beam, -1.0).astype(np.int16)
