"""Surroundings of a scene: statistics of its clouds that depend on the weather, and its place.

They describe a scene for selections and comparisons. No score, track or label depends on them.
"""

import math
from typing import Annotated, Any, Final, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from schemas.bounds import Finite, Name, Tally

EARTH: Final = "wgs84"
"""Frame of latitude and longitude."""

METRES_PER_DEGREE: Final = 111_320.0
"""Metres of a degree of latitude, and of longitude at the equator."""

_Share = Annotated[float, Field(ge=0, le=1)]
_Turn = Annotated[float, Field(ge=-3.1416, le=3.1416)]


def metres_per_degree_east(latitude_deg: float) -> float:
    """Return the metres of a degree of longitude; never 0, also at a pole."""
    return METRES_PER_DEGREE * max(math.cos(math.radians(latitude_deg)), 1e-3)


def _is_none(value: Any) -> bool:
    return value is None


class CloudStatistics(BaseModel):
    """Statistics of a scene's clouds that rain, spray, snow and fog change."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    returns: Tally = Field(description="Mean number of returns of a frame.")
    range_m: Finite = Field(ge=0, description="Median range of the returns, metres.")
    airborne_share: _Share = Field(
        description="Share of the returns within 10 m of the sensor that have at most one other "
        "return around them: drops, flakes and spray."
    )
    missing_share: _Share | None = Field(
        default=None,
        exclude_if=_is_none,
        description="Share of the firings without a return, if each beam fires as often as the one "
        "with the most returns; absent where the log has no beam numbers.",
    )
    intensity: _Share | None = Field(
        default=None,
        exclude_if=_is_none,
        description="Median intensity of the returns; absent where the log has none.",
    )


class ScenePlace(BaseModel):
    """Place of the sensor at the middle of a scene, in a frame that drives share."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    frame: Name = Field(
        default=EARTH,
        exclude_if=lambda value: value == EARTH,
        description="Name of a frame in metres, as the log has it; absent: latitude and longitude.",
    )
    latitude_deg: float | None = Field(
        default=None, ge=-90, le=90, exclude_if=_is_none, description="Degrees, north positive."
    )
    longitude_deg: float | None = Field(
        default=None, ge=-180, le=180, exclude_if=_is_none, description="Degrees, east positive."
    )
    x_m: Finite | None = Field(
        default=None, exclude_if=_is_none, description="Metres in the named frame."
    )
    y_m: Finite | None = Field(
        default=None, exclude_if=_is_none, description="Metres in the named frame."
    )
    odom_m: tuple[Finite, Finite] = Field(
        description="The same place in the odom space of the scene's tracks, x and y, metres."
    )
    odom_yaw_rad: _Turn | None = Field(
        default=None,
        exclude_if=_is_none,
        description="Direction of the odom space's x axis, radians from east (or from the x axis "
        "of the named frame) to the left; absent where the car drove less than 5 m.",
    )
    heading_rad: _Turn | None = Field(
        default=None,
        exclude_if=_is_none,
        description="Direction of the drive at that instant, counted in the same way; absent "
        "where `odom_yaw_rad` is.",
    )

    @model_validator(mode="after")
    def _has_the_coordinates_of_its_frame(self) -> Self:
        degrees, metres = (self.latitude_deg, self.longitude_deg), (self.x_m, self.y_m)
        has, lacks = (degrees, metres) if self.frame == EARTH else (metres, degrees)
        if None in has or lacks != (None, None):
            raise ValueError(
                "a place has latitude and longitude, or a named frame and x and y in metres"
            )
        return self
