"""Bootstrap intervals of figures, resampled over whole logs."""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

DRAWS: Final = 1000
LEVEL: Final = 0.95

MIN_LOGS: Final = 3
"""Logs needed for an interval: one resampled log is itself; of two, half the draws repeat one."""

Interval = tuple[float, float]


def bootstrap(
    groups: Sequence[int],
    figures: Callable[[NDArray[np.int64]], Sequence[float | None]],
    *,
    draws: int = DRAWS,
    seed: int = 0,
) -> list[Interval | None]:
    """Draw logs with replacement and take the middle 95 % of each figure.

    Scenes of one log share street, weather and traffic, so logs are drawn, not scenes.

    Args:
        groups: Log of each item.
        figures: Computes the figures of a draw from its item indices, which repeat; None where a
            figure is undefined.
        draws: Number of draws, at least 1.
        seed: Seed of the draws.

    Returns:
        One interval per figure; None where less than half of the draws define it, or with too few
        logs.
    """
    of = np.asarray(groups)
    names = np.unique(of)
    members = [np.flatnonzero(of == name) for name in names]
    if len(members) < MIN_LOGS:
        return [None for _ in figures(np.arange(len(of)))]
    rng = np.random.default_rng(seed)
    drawn = []
    for _ in range(draws):
        chosen = rng.integers(0, len(members), len(members))
        drawn.append(figures(np.concatenate([members[each] for each in chosen])))
    return [_middle(values) for values in zip(*drawn, strict=True)]


def _middle(figures: Sequence[float | None]) -> Interval | None:
    values = [value for value in figures if value is not None]
    if 2 * len(values) < len(figures):
        return None
    low, high = np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return round(float(low), 4), round(float(high), 4)
