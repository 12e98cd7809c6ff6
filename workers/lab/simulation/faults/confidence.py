"""How sure the model on the car says it is: drawn from what networks said when right and wrong."""

import json
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

TABLE: Final = Path(__file__).parent / "confidence.json"
"""Quantiles that were measured on held-out simulated streets; says which command made it."""

_KNOT_S: Final = 0.7
"""A network that is unsure about a thing is so for about this long."""

_SHARED: Final = 0.9
"""Weight of what lasts against what is new in every frame, in standard deviations."""


@lru_cache(maxsize=1)
def quantiles() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Read the confidences, rising, of right and of wrong labels."""
    table = json.loads(TABLE.read_text())
    return np.array(table["right"], dtype=np.float64), np.array(table["wrong"], dtype=np.float64)


def draw_confidence(
    *, seed: int, things: int, time_s: float, index: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw how sure the model is of each thing in one frame, were it right and were it wrong.

    A Gaussian copula over the measured quantiles: each thing has a mood that changes within a
    second, the same for both answers, with a little noise from frame to frame. It depends on seed,
    thing and time alone, so frames can be made in any order.

    Args:
        seed: Of the street.
        things: How many there are.
        time_s: Of the frame.
        index: Its number.

    Returns:
        (things,) if right, (things,) if wrong; 0 to 1.
    """
    knot, share = divmod(time_s / _KNOT_S, 1.0)
    before, after = (
        np.random.default_rng([seed, 0xC0F, int(knot) + ahead]).standard_normal(things)
        for ahead in (0, 1)
    )
    mood = ((1.0 - share) * before + share * after) / np.hypot(1.0 - share, share)
    fresh = np.random.default_rng([seed, 0xC1F, index]).standard_normal(things)
    latent = _SHARED * mood + np.sqrt(1.0 - _SHARED**2) * fresh
    rank = _normal_cdf(latent)
    right, wrong = quantiles()
    steps = np.linspace(0.0, 1.0, len(right)), np.linspace(0.0, 1.0, len(wrong))
    return np.interp(rank, steps[0], right), np.interp(rank, steps[1], wrong)


def _normal_cdf(values: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.special import ndtr

    return np.asarray(ndtr(values), dtype=np.float64)
