"""Calibration of a score: reliability diagram in bins, and expected calibration error."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import Mask

BINS: Final = 10


class Bin(BaseModel):
    """One bin of a reliability diagram: mean score against observed share."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    count: int
    said: float = Field(description="Mean score.")
    was: float = Field(description="Observed share of positives.")


class Calibration(BaseModel):
    """Calibration of a score that is used as a probability."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    ece: float | None = Field(description="Expected calibration error, 0 is best; null: no items.")
    bins: tuple[Bin, ...] = Field(description="Ten of equal width from 0 to 1, empty ones left out")


def calibrate(predicted: NDArray[np.float64] | Sequence[float], observed: Mask) -> Calibration:
    """Compare scores with outcomes in ten bins of equal width (Guo et al., ICML 2017).

    Args:
        predicted: (N,) scores, 0 to 1.
        observed: (N,) outcomes.
    """
    scores = np.asarray(predicted, dtype=np.float64)
    place = np.clip((scores * BINS).astype(np.int64), 0, BINS - 1)
    bins, error = [], 0.0
    for each in range(BINS):
        mine = place == each
        if mine.any():
            mean, share = float(scores[mine].mean()), float(observed[mine].mean())
            bins.append(Bin(count=int(mine.sum()), said=round(mean, 4), was=round(share, 4)))
            error += float(mine.mean()) * abs(mean - share)
    return Calibration(ece=round(error, 4) if len(scores) else None, bins=tuple(bins))
