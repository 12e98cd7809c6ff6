"""Costs of a fleet for a day and a month: cores, bytes, disk and money, from rates of mining."""

from dataclasses import dataclass
from typing import Final

from pydantic import BaseModel, ConfigDict, Field

HOURS_OF_A_DAY: Final = 24.0
DAYS_OF_A_MONTH: Final = 30.0
GB: Final = 1e9

DEFAULT_SECONDS: Final = 0.33
"""Seconds of one core per frame of 106,000 points, as in the runbook."""

DEFAULT_BYTES_READ: Final = 0.84e6 * 1.06
"""Bytes read from the bucket per frame, PandaSet, at default shards."""

OVERLAY_BYTES_A_POINT: Final = 3.1
"""Bytes of overlay per point, without pictures: 19.6 MB in three scenes of PandaSet."""

DEFAULT_OVERLAY_BYTES: Final = 106_000 * OVERLAY_BYTES_A_POINT
"""Bytes of overlay per frame."""

DEFAULT_RECORD_BYTES: Final = 30e3
"""Bytes of database per scene: record, indexes and listing."""


@dataclass(frozen=True, slots=True)
class FrameRates:
    """Costs of one frame.

    Attributes:
        seconds: Seconds of one core.
        bytes_read: Bytes read from the bucket.
        overlay_bytes: Bytes of overlay.
        measured_frames: Frames that they were measured on; 0: defaults.
    """

    seconds: float = DEFAULT_SECONDS
    bytes_read: float = DEFAULT_BYTES_READ
    overlay_bytes: float = DEFAULT_OVERLAY_BYTES
    measured_frames: int = 0


@dataclass(frozen=True, slots=True)
class Fleet:
    """Fleet whose costs are computed.

    Attributes:
        cars: Cars that drive in a day.
        hours: Hours that each records in a day.
        lidars: Lidars of each that are mined.
        hz: Frames per second of each lidar.
        scene_s: Length of a scene, seconds.
        keep_days: Days for which overlays are kept.
    """

    cars: int
    hours: float
    lidars: int = 1
    hz: float = 10.0
    scene_s: float = 2.0
    keep_days: float = 90.0


@dataclass(frozen=True, slots=True)
class Prices:
    """Prices, in one currency.

    Attributes:
        core_hour: Of one core for an hour.
        gb_month: Of one GB kept for a month.
        gb_read: Of one GB read from the bucket; 0 within one region of most stores.
    """

    core_hour: float = 0.04
    gb_month: float = 0.023
    gb_read: float = 0.0


class FleetCosts(BaseModel):
    """Costs of a fleet."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    frames_a_day: float
    scenes_a_day: float
    core_hours_a_day: float
    cores: float = Field(description="Cores that work all day.")
    read_gb_a_day: float
    overlay_gb_a_day: float
    overlay_gb_kept: float = Field(description="Overlays on disk after the days of keeping.")
    database_gb_a_year: float
    seconds_per_frame: float
    measured_frames: int = Field(description="Frames behind the rates; 0: defaults.")
    core_money_a_month: float
    read_money_a_month: float
    disk_money_a_month: float = Field(description="Of overlays, once the days of keeping are over.")
    money_a_month: float
    money_an_hour_driven: float


def costs_of(fleet: Fleet, rates: FrameRates, prices: Prices) -> FleetCosts:
    """Compute the costs of a fleet; amounts are linear in frames."""
    driven_s = fleet.cars * fleet.hours * 3600.0 * fleet.lidars
    frames = driven_s * fleet.hz
    scenes = driven_s / fleet.scene_s
    core_hours = frames * rates.seconds / 3600.0
    read_gb, overlay_gb = frames * rates.bytes_read / GB, frames * rates.overlay_bytes / GB
    kept_gb = overlay_gb * fleet.keep_days
    core_money = core_hours * DAYS_OF_A_MONTH * prices.core_hour
    read_money = read_gb * DAYS_OF_A_MONTH * prices.gb_read
    disk_money = kept_gb * prices.gb_month
    money = core_money + read_money + disk_money
    return FleetCosts(
        frames_a_day=frames,
        scenes_a_day=scenes,
        core_hours_a_day=core_hours,
        cores=core_hours / HOURS_OF_A_DAY,
        read_gb_a_day=read_gb,
        overlay_gb_a_day=overlay_gb,
        overlay_gb_kept=kept_gb,
        database_gb_a_year=scenes * 365 * DEFAULT_RECORD_BYTES / GB,
        seconds_per_frame=rates.seconds,
        measured_frames=rates.measured_frames,
        core_money_a_month=core_money,
        read_money_a_month=read_money,
        disk_money_a_month=disk_money,
        money_a_month=money,
        money_an_hour_driven=money / (DAYS_OF_A_MONTH * fleet.cars * fleet.hours),
    )
