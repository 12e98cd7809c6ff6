"""How far a figure would move, had other logs been drawn: bootstrap over whole logs."""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

DRAWS: Final = 1000
LEVEL: Final = 0.95

Interval = tuple[float, float]


def bootstrap(
    groups: Sequence[int],
    figure: Callable[[NDArray[np.int64]], float | None],
    *,
    draws: int = DRAWS,
    seed: int = 0,
) -> Interval | None:
    """Draw logs with replacement and take the middle 95 % of the figure.

    Scenes of one log share street, weather and traffic, so logs are drawn, not scenes.

    Args:
        groups: Log of each item.
        figure: Given the items of a draw, repeated as they were drawn; None where it has none.
        draws: How often.
        seed: Of the draws.

    Returns:
        None where less than half of the draws have a figure.
    """
    of = np.asarray(groups)
    names = np.unique(of)
    members = [np.flatnonzero(of == name) for name in names]
    rng = np.random.default_rng(seed)
    values = []
    for _ in range(draws):
        chosen = rng.integers(0, len(members), len(members))
        value = figure(np.concatenate([members[each] for each in chosen]))
        if value is not None:
            values.append(value)
    if 2 * len(values) < draws:
        return None
    low, high = np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return round(float(low), 4), round(float(high), 4)
