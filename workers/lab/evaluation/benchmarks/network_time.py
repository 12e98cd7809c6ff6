"""Benchmark row of one implementation of a network."""

import statistics
from collections.abc import Sequence
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

Network = Literal["salsanext", "lmnet", "flowstep3d"]


class NetworkTime(BaseModel):
    """Time of one implementation of a network, compared with the plain one."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    network: Network
    way: str = Field(description="`plain` is the published forward pass, eager, batch 1, float32.")
    size: str = Field(description="Size of the image or the cloud.")
    median_ms: float
    faster: float = Field(description="Speed-up: median over rounds of plain time over this time.")
    changed: float | None = Field(
        default=None, description="Share of labels that differ from plain's; of flow, metres."
    )
    memory_mib: float | None = Field(
        default=None, description="Additional peak memory while running."
    )


def times_as_fast(plain: Sequence[float], other: Sequence[float]) -> float:
    """Return the median over pairs of the plain time over the other."""
    return statistics.median(one / two for one, two in zip(plain, other, strict=True))
