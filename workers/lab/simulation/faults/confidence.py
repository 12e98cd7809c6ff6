"""Simulated confidence of the on-board model, drawn from measured confidences of real networks."""

import json
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

TABLE: Final = Path(__file__).parent / "confidence.json"
"""Quantiles measured on held-out simulated streets; the file names the command that made it."""

_KNOT_S: Final = 0.7
"""Correlation time of a network's confidence on an object, seconds."""

_SHARED: Final = 0.9
"""Weight of the lasting part of the confidence against the per-frame part, standard deviations."""


@lru_cache(maxsize=1)
def quantiles() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Read the quantiles of confidence, rising, of right and of wrong labels."""
    table = json.loads(TABLE.read_text())
    return np.array(table["right"], dtype=np.float64), np.array(table["wrong"], dtype=np.float64)


def draw_confidence(
    *, seed: int, things: int, time_s: float, index: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw the model's confidence on each object in one frame, for a right and for a wrong label.

    A Gaussian copula over the measured quantiles: each object has a latent value that changes
    within a second, the same for both labels, plus small noise per frame. It depends on seed,
    object and time alone, so frames can be simulated in any order.

    Args:
        seed: Seed of the street.
        things: Number of objects.
        time_s: Time of the frame.
        index: Number of the frame.

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


def draw_border_confidence(*, seed: int, count: int, index: int) -> NDArray[np.float64]:
    """Draw the confidence on single points that the noise of a model labels wrong, (count,).

    It is the lower half of the measured confidences of wrong labels, because a network is less sure
    at a border than on an object that it mistakes.
    """
    _, wrong = quantiles()
    rank = 0.5 * np.random.default_rng([seed, 0xC2F, index]).random(count)
    return np.interp(rank, np.linspace(0.0, 1.0, len(wrong)), wrong)


def _normal_cdf(values: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.special import ndtr

    return np.asarray(ndtr(values), dtype=np.float64)
