"""Means over several logs, with bootstrap intervals over logs."""

from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict

from workers.lab.evaluation.failures.intervals import bootstrap


def pooled(sums: ArrayLike, weights: ArrayLike) -> float | None:
    """Return the mean of sums over all logs, to four digits; None without weight."""
    total = float(np.sum(weights))
    return round(float(np.sum(sums)) / total, 4) if total else None


class Interval(BaseModel):
    """Bootstrap interval of a mean, 95 %, logs drawn as a whole."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    low: float
    high: float

    @classmethod
    def over_logs(cls, sums: ArrayLike, weights: ArrayLike) -> Self | None:
        """Draw logs with replacement; None with fewer than three.

        Args:
            sums: (L,) sum of each log.
            weights: (L,) weight of each log.
        """
        of_log, weight = np.asarray(sums, np.float64), np.asarray(weights, np.float64)
        (found,) = bootstrap(
            range(len(of_log)), lambda drawn: [pooled(of_log[drawn], weight[drawn])]
        )
        return None if found is None else cls(low=found[0], high=found[1])
