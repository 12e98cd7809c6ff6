"""Objectives of a selection: what each candidate adds to the scenes that are already chosen. Pure.

Both join the score with the likeness of descriptors, and both add the same term for balance: the
sum over vehicles, software versions, kinds and places of log(1 + chosen scores of the group). What
a candidate adds never grows as others are chosen, and is bounded by its score alone.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from service.curation.candidates import BALANCED, PLACE, Rows

Gains = NDArray[np.float64]

SHARPNESS: Final = 32
NEAR_SHARPNESS: Final = 128
"""Powers of the likeness in `Determinantal` and in `KCentre`: only scenes that are alike in nearly
everything count as the same. Lower ones also hold back other failures of the same kind.
"""

SPREAD: Final = 10.0
"""Weight of the likeness in `Determinantal`: near 0 the order is that of the score alone."""

BALANCE: Final = 0.05
"""Weight of `Balance`. These numbers were chosen on 120 simulated scenes, of which nothing is
reported.
"""


class Objective(Protocol):
    """Value of the taken ones of a fixed set of candidates, by what each further one adds."""

    def gains(self) -> Gains:
        """Return what each candidate adds to those taken."""
        ...

    def take(self, number: int) -> None:
        """Take a candidate."""
        ...


@dataclass(frozen=True, slots=True)
class ObjectiveKind:
    """A kind of objective.

    Attributes:
        begin: Makes the objective of some candidates, with nothing taken.
        most: Returns the most that a candidate of a score can add, whatever is taken.
    """

    begin: Callable[[Rows], Objective]
    most: Callable[[float], float]


class Balance:
    """Sum over the groups of log(1 + chosen scores of the group), times `BALANCE`.

    A candidate without a place has no term for it.
    """

    def __init__(self, rows: Rows) -> None:
        """Begin with nothing taken."""
        self._quality = rows.quality
        self._codes = [np.unique(each, return_inverse=True)[1] for each in rows.groups.T]
        self._sums = [np.zeros(int(codes.max(initial=-1)) + 1) for codes in self._codes]
        self._is_placed = rows.groups[:, PLACE] != 0

    def gains(self) -> Gains:
        """Return what each candidate adds to those taken."""
        found = np.zeros(len(self._quality))
        for group, (codes, sums) in enumerate(zip(self._codes, self._sums, strict=True)):
            more = np.log1p(self._quality / (1.0 + sums)[codes])
            found += more * self._is_placed if group == PLACE else more
        return BALANCE * found

    def take(self, number: int) -> None:
        """Take a candidate."""
        for codes, sums in zip(self._codes, self._sums, strict=True):
            sums[codes[number]] += self._quality[number]


class Determinantal:
    """Log-determinant of 1 + `SPREAD` * L over the chosen, with L of score times likeness.

    L[i, j] = score_i * score_j * likeness_ij ** `SHARPNESS`. It is monotone and submodular, so that
    greedy choices reach at least 1 - 1/e of the best value. The determinant is updated by one row
    of its Cholesky factor for each choice.
    """

    def __init__(self, rows: Rows) -> None:
        """Begin with nothing taken."""
        self._scaled = (math.sqrt(SPREAD) * rows.quality).astype(np.float32)
        self._descriptors = rows.descriptors
        self._variance = 1.0 + self._scaled.astype(np.float64) ** 2
        self._factor = np.empty((16, len(rows)), np.float32)
        self._taken = 0
        self._balance = Balance(rows)

    def gains(self) -> Gains:
        """Return what each candidate adds to those taken."""
        return np.log(np.maximum(self._variance, 1.0)) + self._balance.gains()

    def take(self, number: int) -> None:
        """Take a candidate."""
        likeness = self._descriptors @ self._descriptors[number]
        row = self._scaled * self._scaled[number] * likeness**SHARPNESS
        before = self._factor[: self._taken]
        row -= before[:, number] @ before
        row /= np.float32(np.sqrt(max(self._variance[number], 1.0)))
        if self._taken == len(self._factor):
            self._factor = np.concatenate([self._factor, np.empty_like(self._factor)])
        self._factor[self._taken] = row
        self._taken += 1
        self._variance -= row.astype(np.float64) ** 2
        self._balance.take(number)


class KCentre:
    """Score times the distance to the nearest chosen one: 1 - likeness ** `NEAR_SHARPNESS`."""

    def __init__(self, rows: Rows) -> None:
        """Begin with nothing taken."""
        self._quality, self._descriptors = rows.quality, rows.descriptors
        self._distance = np.ones(len(rows))
        self._balance = Balance(rows)

    def gains(self) -> Gains:
        """Return what each candidate adds to those taken."""
        return self._quality * self._distance + self._balance.gains()

    def take(self, number: int) -> None:
        """Take a candidate."""
        likeness = self._descriptors @ self._descriptors[number]
        np.minimum(self._distance, 1.0 - likeness**NEAR_SHARPNESS, out=self._distance)
        np.maximum(self._distance, 0.0, out=self._distance)
        self._balance.take(number)


def most_determinantal(quality: float) -> float:
    """Return the most that a candidate of this score can add to `Determinantal`."""
    return math.log1p(SPREAD * quality**2) + _most_balance(quality)


def most_k_centre(quality: float) -> float:
    """Return the most that a candidate of this score can add to `KCentre`."""
    return quality + _most_balance(quality)


def _most_balance(quality: float) -> float:
    return BALANCE * len(BALANCED) * math.log1p(quality)


DETERMINANTAL: Final = ObjectiveKind(Determinantal, most_determinantal)
K_CENTRE: Final = ObjectiveKind(KCentre, most_k_centre)
