"""Ranges of tracks as bits, one for each metre: two numbers by which they are filtered. Pure."""

import math
from collections.abc import Iterable
from typing import Annotated, Final

from pydantic import Field

BITS: Final = 63
"""Bits of one number: as many as a signed 64-bit integer of a database has without its sign."""

MAX_BOUND_M: Final = 2 * BITS - 1
"""Greatest bound of a filter, metres. The last bit is of every range beyond it; both streams label
up to 80 m."""

RangeBits = tuple[int, int]
"""Metres of which something is true, as bits of two numbers. Bit n of the first one is of ranges
beyond n metres and within n + 1, bit 0 also of a range of 0; those of the second follow after 63 m.
"""

Beyond = Annotated[int, Field(ge=0, le=MAX_BOUND_M)]
"""A bound that a range exceeds, whole metres."""

Within = Annotated[int, Field(ge=1, le=MAX_BOUND_M)]
"""A bound that a range does not exceed, whole metres."""


def bits_of(ranges_m: Iterable[float]) -> RangeBits:
    """Return the bits of the metres in which any of these ranges, metres, is."""
    found = 0
    for range_m in ranges_m:
        found |= 1 << min(max(math.ceil(range_m) - 1, 0), MAX_BOUND_M)
    return _halves(found)


def bits_between(beyond_m: int | None, within_m: int | None) -> RangeBits:
    """Return the bits of every range between two bounds, metres; None: no bound."""
    end = MAX_BOUND_M + 1 if within_m is None else within_m
    return _halves((1 << end) - (1 << min(beyond_m or 0, end)))


def _halves(bits: int) -> RangeBits:
    return bits & (1 << BITS) - 1, bits >> BITS
