"""Thresholds of the paper's two-stage rule, as the setting `motion_rule` gives them."""

from typing import Final

from pydantic import BaseModel, ConfigDict, Field

KMH: Final = 1 / 3.6
"""Metres per second of one km/h."""

MAX_REACH: Final = 100.0
"""Largest distance, metres, and largest speed, m/s, of any threshold."""


class MotionRule(BaseModel):
    """Thresholds of the rule; by default those that were published (arXiv 2407.14306, its code)."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    reach_m: float = Field(
        default=0.6, gt=0, le=MAX_REACH, description="Neighbour distance of stage 1, metres."
    )
    min_points: int = Field(
        default=30, ge=1, le=10_000, description="Points of a core point's neighbourhood, stage 1."
    )
    max_spread: float = Field(
        default=0.12,
        gt=0,
        le=MAX_REACH,
        description="Standard deviation over mean of speed, above which a cluster is not rigid.",
    )
    max_speed_m_per_s: float = Field(
        default=80 * KMH, gt=0, le=1_000, description="Faster points leave stage 1's statistics."
    )
    flow_reach_m_per_s: float = Field(
        default=0.15, gt=0, le=MAX_REACH, description="Neighbour distance of velocities, stage 2."
    )
    flow_reach_m: float | None = Field(
        default=None,
        gt=0,
        le=MAX_REACH,
        description="The same per frame interval, as published; null: per second.",
    )
    min_flow_points: int = Field(
        default=25, ge=1, le=10_000, description="Points of a core point's neighbourhood, stage 2."
    )
    min_speed_m_per_s: float = Field(
        default=4 * KMH, ge=0, le=MAX_REACH, description="Slower clusters are static."
    )


PER_SECOND: Final = MotionRule()
PAPER: Final = MotionRule(flow_reach_m=0.015)
"""Published form: 0.015 m per frame, which is 0.15 m/s at 10 Hz only."""
