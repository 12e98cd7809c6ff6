"""What one comparison with a reference output found, and how comparisons are made."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True)
class Difference:
    """One comparison.

    Attributes:
        what: Which output, and where not all of it is compared, which part.
        largest: Largest difference, or how many elements differ; infinite where shapes differ or
            one has a number and the other none.
        tolerance: What it may be at most.
        holds: Whether it is not more.
    """

    what: str
    largest: float
    tolerance: float
    holds: bool


def near(what: str, found: ArrayLike, expected: ArrayLike, *, tolerance: float) -> Difference:
    """Compare numbers: the largest absolute difference; NaN equals NaN only."""
    return _difference(what, _largest(found, expected), tolerance)


def relative(what: str, found: ArrayLike, expected: ArrayLike, *, tolerance: float) -> Difference:
    """Compare numbers, each to its own size."""
    wanted = np.asarray(expected, np.float64)
    size = np.where(np.isfinite(wanted) & (wanted != 0), np.abs(wanted), 1.0)
    got = np.asarray(found, np.float64)
    if got.shape != wanted.shape:
        return _difference(f"{what} {_shapes(got, wanted)}", np.inf, tolerance)
    return _difference(what, _largest(got / size, wanted / size), tolerance)


def to_scale(what: str, found: ArrayLike, expected: ArrayLike, *, tolerance: float) -> Difference:
    """Compare numbers to the largest of the expected ones, as gradients are."""
    size = float(np.abs(np.asarray(expected, np.float64)).max(initial=0.0)) or 1.0
    return _difference(what, _largest(found, expected) / size, tolerance)


def same(what: str, found: ArrayLike, expected: ArrayLike, *, allowed: int = 0) -> Difference:
    """Compare element by element: how many differ."""
    got, wanted = np.asarray(found), np.asarray(expected)
    if got.shape != wanted.shape:
        return _difference(f"{what} {_shapes(got, wanted)}", np.inf, allowed)
    return _difference(what, float(np.count_nonzero(got != wanted)), allowed)


def quantile(
    what: str, found: ArrayLike, expected: ArrayLike, *, share: float, tolerance: float
) -> Difference:
    """Compare all but the worst: the difference that this share of the elements does not exceed."""
    got, wanted = np.asarray(found, np.float64), np.asarray(expected, np.float64)
    if got.shape != wanted.shape or not np.isfinite(got).all():
        return _difference(f"{what} {_shapes(got, wanted)}", np.inf, tolerance)
    apart = np.sort(np.abs(got - wanted), axis=None)
    worst = float(apart[math.ceil(share * apart.size) - 1]) if apart.size else 0.0
    return _difference(f"{what}, {share:.0%} of it", worst, tolerance)


def _largest(found: ArrayLike, expected: ArrayLike) -> float:
    got, wanted = np.asarray(found, np.float64), np.asarray(expected, np.float64)
    if got.shape != wanted.shape:
        return float("inf")
    known = np.isfinite(wanted)
    alike = (got == wanted) | (np.isnan(got) & np.isnan(wanted))
    if not alike[~known].all() or not np.isfinite(got[known]).all():
        return float("inf")
    return float(np.abs(got[known] - wanted[known]).max(initial=0.0))


def _shapes(found: np.ndarray, expected: np.ndarray) -> str:
    return "" if found.shape == expected.shape else f"({found.shape} for {expected.shape})"


def _difference(what: str, largest: float, tolerance: float) -> Difference:
    return Difference(what.strip(), largest, float(tolerance), largest <= tolerance)
