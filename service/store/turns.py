"""Turns: the numbers that order claims, by kind of work, priority and time.

A turn of work that is mined again has the kind above 40 bits, then the priority in 6 bits, then the
time in 34 bits, the newer log first. New work and scores that are computed again have no time:
their turn is that of the kind, less the places by which a priority precedes the last.
"""

from collections.abc import Collection, Iterator
from enum import IntEnum
from typing import Final

_BITS: Final = 40
_TIME_BITS: Final = 34
_LATEST_S: Final = 2**_TIME_BITS - 1
"""Latest time that a turn orders, seconds since the Unix epoch: the year 2514."""

LAST_LANE: Final = 2 ** (_BITS - _TIME_BITS) - 1
"""Lane of logs without a priority, 63; a lane is the place of a priority."""

FIRST_TURN: Final = -(2**62)
NO_LIMIT: Final = 2**62


class Kind(IntEnum):
    """Kind of work, in the order of claims."""

    NEW = 0
    RESCORED = 1
    CANARY = 2
    CHOSEN = 3
    REST = 4

    @property
    def first_turn(self) -> int:
        """Return the lowest turn of this kind; priorities of the first two kinds precede it."""
        return self << _BITS


def turn_of(kind: Kind, *, newest_s: float = 0.0, lane: int = LAST_LANE) -> int:
    """Return the turn of work; the earlier lane first, then the newer log."""
    if kind < Kind.CANARY:
        return kind.first_turn - (LAST_LANE - lane)
    time = _LATEST_S - min(_LATEST_S, max(0, int(newest_s)))
    return kind.first_turn + (lane << _TIME_BITS) + time


def lane_of(turn: int) -> int:
    """Return the lane of a turn."""
    if turn < Kind.CANARY.first_turn:
        return LAST_LANE + turn - _without_time(turn).first_turn
    return (turn >> _TIME_BITS) & LAST_LANE


def in_lane(turn: int, lane: int) -> int:
    """Return the turn of the same kind and time in another lane."""
    if turn < Kind.CANARY.first_turn:
        return turn_of(_without_time(turn), lane=lane)
    return turn + ((lane - lane_of(turn)) << _TIME_BITS)


def stretches(
    closed: Collection[int], *, below: int = NO_LIMIT, of: Collection[int] = ()
) -> Iterator[tuple[int, int]]:
    """Yield the stretches of turns that are open, in order: the first turn, and the one after.

    Args:
        closed: Lanes that are left out.
        below: Turn below which work is claimed.
        of: Lanes that alone are open; empty: every other one.
    """
    lanes = sorted(of) if of else sorted(closed)
    taken = sorted(_stretch(kind, lane) for kind in Kind for lane in lanes)
    if of:
        yield from ((first, min(after, below)) for first, after in taken if first < below)
        return
    begin = FIRST_TURN
    for first, after in taken:
        if begin < min(first, below):
            yield begin, min(first, below)
        begin = max(begin, after)
    if begin < below:
        yield begin, below


def _without_time(turn: int) -> Kind:
    return Kind.NEW if turn <= Kind.NEW.first_turn else Kind.RESCORED


def _stretch(kind: Kind, lane: int) -> tuple[int, int]:
    if kind < Kind.CANARY:
        turn = turn_of(kind, lane=lane)
        return turn, turn + 1
    first = kind.first_turn + (lane << _TIME_BITS)
    return first, first + (1 << _TIME_BITS)
