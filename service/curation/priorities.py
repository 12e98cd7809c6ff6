"""Priorities of vehicles and folders: which logs come first, and how much of the fleet they take.

A priority is written `PATTERN`, `PATTERN=4` or `PATTERN=25%`. The pattern is compared with the log
id, its folders and the vehicle.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import translate
from functools import cached_property
from typing import Final, Self

MAX_PRIORITIES: Final = 60
"""Most priorities; a turn of the ledger has six bits for them."""

OTHERS: Final = "others"
"""Word for the logs that no pattern matches; without it they come last."""

_LIMIT: Final = re.compile(r"(?P<number>\d{1,7})(?P<percent>%?)")


@dataclass(frozen=True, slots=True)
class Priority:
    """One entry of the order.

    Attributes:
        pattern: Shell pattern for log ids, their folders or vehicles, `*` also for `/`, or
            `OTHERS`.
        most_leases: Leases that its logs hold at a time at most; None: no limit.
        most_share: Share of all held leases, 0 to 1, that they hold while other work waits; None:
            no limit.
    """

    pattern: str
    most_leases: int | None = None
    most_share: float | None = None

    @classmethod
    def parse(cls, written: str) -> Self:
        """Read one entry.

        Raises:
            ValueError: If the limit is neither a number of leases nor a percentage, or is 0.
        """
        pattern, separator, limit = written.rpartition("=")
        if not separator:
            return cls(written)
        found = _LIMIT.fullmatch(limit)
        number = int(found["number"]) if found else 0
        if not pattern or not found or number < 1 or (found["percent"] and number > 100):
            raise ValueError("PATTERN, PATTERN=4 (leases) or PATTERN=25% (of the leases)")
        if found["percent"]:
            return cls(pattern, most_share=number / 100)
        return cls(pattern, most_leases=number)

    @property
    def has_limit(self) -> bool:
        """Return true if its logs may not hold every lease."""
        return self.most_leases is not None or self.most_share is not None

    def is_full(self, held: int, *, of: int) -> bool:
        """Return true if its logs get no further lease now.

        Args:
            held: Leases that they hold.
            of: Leases that all logs hold.
        """
        if self.most_leases is not None:
            return held >= self.most_leases
        return self.most_share is not None and held >= max(1, int(self.most_share * (of + 1)))


@dataclass(frozen=True)
class Priorities:
    """Order of logs by pattern; the first entry that matches counts."""

    entries: tuple[Priority, ...] = ()

    @classmethod
    def parse(cls, written: Sequence[str]) -> Self:
        """Read all entries.

        Raises:
            ValueError: If an entry cannot be read, or `OTHERS` is named twice.
        """
        entries = tuple(Priority.parse(each) for each in written)
        if sum(each.pattern == OTHERS for each in entries) > 1:
            raise ValueError(f"{OTHERS!r} once at most")
        return cls(entries)

    def __bool__(self) -> bool:
        """Return true if any logs have a priority."""
        return bool(self.entries)

    def place_of(self, log_id: str, vehicle: str) -> int:
        """Return the index of the entry of a log; `len(entries)` for logs that come last."""
        for place, pattern in self._patterns:
            if pattern.match(log_id) or pattern.match(vehicle):
                return place
        return self._others

    def full(self, held: Mapping[int, int], *, strictly: bool = False) -> set[int]:
        """Return the entries whose logs get no further lease, by index.

        Args:
            held: Held leases by index of the entry.
            strictly: True for limits in leases alone: a share bounds only while other work waits.
        """
        total = sum(held.values())
        return {
            place
            for place, each in enumerate(self.entries)
            if each.has_limit
            and not (strictly and each.most_leases is None)
            and each.is_full(held.get(place, 0), of=total)
        }

    @cached_property
    def has_limits(self) -> bool:
        """True if leases have to be counted."""
        return any(each.has_limit for each in self.entries)

    @cached_property
    def _patterns(self) -> tuple[tuple[int, re.Pattern[str]], ...]:
        return tuple(
            (place, re.compile(f"{translate(each.pattern)}|{translate(each.pattern + '/*')}"))
            for place, each in enumerate(self.entries)
            if each.pattern != OTHERS
        )

    @cached_property
    def _others(self) -> int:
        places = [place for place, each in enumerate(self.entries) if each.pattern == OTHERS]
        return places[0] if places else len(self.entries)
