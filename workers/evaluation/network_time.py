"""What a bench says of one way to run a network."""

import statistics
from collections.abc import Iterable, Sequence
from typing import Final, Literal

from pydantic import BaseModel, ConfigDict, Field

MOST_CHANGED: Final = 0.001
"""A way that changes more labels than this is not recommended."""

Network = Literal["salsanext", "lmnet", "flowstep3d"]


class NetworkTime(BaseModel):
    """One way to run a network, beside the plain one."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    network: Network
    way: str = Field(description="`plain` is the published forward pass, eager, batch 1, float32.")
    size: str = Field(description="Of the image or the cloud.")
    median_ms: float
    faster: float = Field(description="Median over the rounds of plain's time over this one's.")
    changed: float | None = Field(
        default=None, description="Share of labels that differ from plain's; of flow, metres."
    )
    memory_mib: float | None = Field(
        default=None, description="Most held while running, beyond the process before it."
    )


def times_as_fast(plain: Sequence[float], other: Sequence[float]) -> float:
    """Median over pairs of the plain time over the other."""
    return statistics.median(one / two for one, two in zip(plain, other, strict=True))


def recommended(rows: Iterable[NetworkTime]) -> str:
    """Say how to run SalsaNext and LMNet on this machine; empty if they were not timed.

    The fastest part that exists and changes no more than a thousandth of the labels; a worker owns
    one core and answers frame by frame, so that ways with threads or batches are shown and not
    recommended.
    """
    parts = {"eager": "salsanext-lmnet", "folded": "salsanext-lmnet:folded"}
    times: dict[str, list[NetworkTime]] = {}
    for row in rows:
        if row.way in parts and row.network != "flowstep3d":
            times.setdefault(row.way, []).append(row)
    fitting = {
        way: sum(row.median_ms for row in its)
        for way, its in times.items()
        if all((row.changed or 0.0) <= MOST_CHANGED for row in its)
    }
    return parts[min(fitting, key=lambda way: fitting[way])] if fitting else ""
