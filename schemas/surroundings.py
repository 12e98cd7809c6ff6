"""Surroundings of a scene: statistics of its clouds that depend on the weather.

They describe a scene for selections and comparisons. No score, track or label depends on them.
"""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import Finite, Tally

_Share = Annotated[float, Field(ge=0, le=1)]


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
