"""Sensor profile: a range image fitted to any lidar, with layout, means and deviations."""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from itertools import islice
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from schemas.frame import LidarFrame
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from schemas.work import Recording
from workers.errors import LogUnusableError
from workers.ingest.read import read_shard
from workers.lab.calibration.sensor_layout import measure_layout
from workers.lab.evaluation.truth.whole_log import plan_of_log
from workers.lidar.beam_table import MIN_RANGE_M
from workers.lidar.range_image import CHANNELS, SensorProfile, image_channels, project

_DIGITS: Final = 4
_ALIKE: Final = 1.25
_ALIKE_DEG: Final = 4.0
"""Tolerance between logs of one sensor: ratio of beams, elevation of the lowest beam in degrees."""


class SensorFit(BaseModel):
    """A fitted profile, and the shares of points and pixels that it covers."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    profile: SensorProfile = Field(description="Layout and normalisation of the range image.")
    frames: int = Field(description="Number of measured frames.")
    beams: int = Field(description="Beams of the sensor; further rows lie above the topmost.")
    steps_per_turn: int = Field(description="Measured steps of azimuth of a whole turn.")
    projected_share: float = Field(description="Points that lie in the field of view.")
    seen_share: float = Field(description="Points visible in their pixel.")
    filled_share: float = Field(description="Pixels that show a point.")
    remarks: tuple[str, ...] = Field(description="Remarks on how this was measured.")


def sample_frames(
    bucket: Bucket, recording: Recording, settings: MiningSettings, *, frames: int, every: int
) -> list[LidarFrame]:
    """Read some frames of a log, from its beginning on.

    Args:
        bucket: Bucket of the log.
        recording: The log.
        settings: Ingest settings, with the lidar topic.
        frames: Largest number of frames.
        every: Step between frames, so that they are of different places.

    Raises:
        LogUnusableError: If none can be read.
    """
    plan = plan_of_log(bucket, recording, settings)
    if len(plan.lidar_topics) > 1:
        raise LogUnusableError(
            f"cannot calibrate with {recording.log_id}: it has several lidars, "
            f"{', '.join(plan.lidar_topics)}; name one with --topic"
        )
    reader = read_shard(bucket, recording, plan.shards[0], settings)
    sampled = list(islice(reader.frames(), 0, frames * every, every))
    if not any(frame.valid_mask.any() for frame in sampled):
        more = f"; --every 1 takes more than {len(sampled)} of its frames" if every > 1 else ""
        raise LogUnusableError(
            f"cannot calibrate with {recording.log_id}: no point of it is valid{more}"
        )
    return sampled


def different_lidars(logs: Mapping[str, Sequence[LidarFrame]]) -> str:
    """Describe logs that seem to be of two sensors; empty where none do.

    Args:
        logs: Frames of each log, by its name.
    """
    found = {}
    for name, frames in logs.items():
        seen = [frame for frame in frames if frame.valid_mask.any()]
        with suppress(ValueError):  # too few points to tell
            found[name] = measure_layout(seen).beams, _lowest_deg(seen)
    names = list(found)
    for name in names[1:]:
        (beams, lowest_deg), (others, other_deg) = found[names[0]], found[name]
        alike = max(beams, others) <= _ALIKE * min(beams, others)
        if not alike or abs(lowest_deg - other_deg) > _ALIKE_DEG:
            return (
                "these look like different lidars, and a profile is of one: "
                f"{names[0]} has {beams} beams down to {lowest_deg:.0f} degrees, "
                f"{name} has {others} down to {other_deg:.0f}"
            )
    return ""


def _lowest_deg(frames: Sequence[LidarFrame]) -> float:
    """Return the elevation of the lowest beam: the road returns it in every frame."""
    points_m = np.concatenate([frame.points_m[frame.valid_mask] for frame in frames])
    across_m = np.hypot(points_m[:, 0], points_m[:, 1])
    elevation_deg = np.degrees(np.arctan2(points_m[:, 2], across_m))[across_m > MIN_RANGE_M]
    return float(np.quantile(elevation_deg, 0.005)) if len(elevation_deg) else 0.0


def fit_profile(
    frames: Sequence[LidarFrame],
    *,
    name: str,
    rows: int | None = None,
    columns: int | None = None,
) -> SensorFit:
    """Fit a profile to the frames of one sensor.

    Args:
        frames: Frames of one sensor, from as many places as available.
        name: Name of the profile in messages.
        rows: Number of evenly spaced rows over the measured field of view, instead of one per beam.
        columns: Number of columns, instead of the measured one.

    Raises:
        LogUnusableError: If the frames contain too few points.
    """
    frames = [frame for frame in frames if frame.valid_mask.any()]
    try:
        layout = measure_layout(frames)
    except ValueError as error:
        raise LogUnusableError(f"cannot calibrate the sensor: {error}") from error
    plain = SensorProfile(
        name=name,
        rows=rows or layout.rows,
        columns=columns or layout.columns,
        fov_up_deg=layout.fov_up_deg,
        fov_down_deg=layout.fov_down_deg,
        elevations_deg=None if rows else layout.elevations_deg,
    )
    remarks = list(layout.remarks) if not rows else []
    sums, squares = np.zeros(len(CHANNELS)), np.zeros(len(CHANNELS))
    pixels = points = projected = 0
    for frame in frames:
        image = project(frame.points_m, plain, valid_mask=frame.valid_mask)
        channels = image_channels(image, frame.points_m, frame.intensity, plain)
        values = channels[:, image.seen_mask].astype(np.float64)
        sums, squares = sums + values.sum(axis=1), squares + (values**2).sum(axis=1)
        pixels += values.shape[1]
        points += int(frame.valid_mask.sum())
        projected += int(image.projected_mask.sum())
    means = sums / pixels
    stds = np.round(np.sqrt(np.maximum(squares / pixels - means**2, 0)), _DIGITS)
    flat = [channel for channel, std in zip(CHANNELS, stds, strict=True) if std == 0]
    if flat:  # a network divides by them
        remarks.append(f"{', '.join(flat)} never varies: its deviation is set to 1")
    stds = np.where(stds > 0, stds, 1.0)
    return SensorFit(
        profile=replace(
            plain,
            means=tuple(np.round(means, _DIGITS).tolist()),
            stds=tuple(stds.tolist()),
        ),
        frames=len(frames),
        beams=layout.beams,
        steps_per_turn=layout.steps_per_turn,
        projected_share=round(projected / points, _DIGITS),
        seen_share=round(pixels / points, _DIGITS),
        filled_share=round(pixels / (plain.rows * plain.columns * len(frames)), _DIGITS),
        remarks=tuple(remarks),
    )


def profile_text(profile: SensorProfile, ending: str) -> str:
    """Write a profile as JSON, the format in weights, or as TOML, the format in adapters.

    Args:
        profile: Profile to write.
        ending: Ending of the file's name, `.json` or `.toml`.

    Raises:
        ValueError: If the ending is another.
    """
    fields = {name: value for name, value in asdict(profile).items() if value is not None}
    if ending == ".json":
        return json.dumps(fields, indent=1) + "\n"
    if (
        ending == ".toml"
    ):  # strings, numbers, booleans and lists have the same form in TOML and JSON
        lines = [f"{name} = {json.dumps(value)}" for name, value in fields.items()]
        return "\n".join(("[profile]", *lines)) + "\n"
    raise ValueError(f"a profile is written to .json or .toml, not {ending!r}")
