"""Bounded queue of requests waiting for a thread; merges equal requests."""

import math
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from threading import Condition
from typing import Final, Generic, TypeVar

Item = TypeVar("Item")


MOST_ALIKE: Final = 64
"""Equal requests merged at most; each gets a copy of a reply that may be long."""


@dataclass(slots=True)
class Group(Generic[Item]):
    """Equal requests that are answered together.

    Attributes:
        turn: Groups of one turn are answered one after the other.
        items: The requests.
        size: Their total size, bytes.
    """

    turn: Hashable
    items: deque[Item] = field(default_factory=deque)
    size: int = 0


class Waiting(Generic[Item]):
    """A queue that merges equal requests.

    A client that repeats a request faster than it is answered gets one reply for all of them. Work
    on that reply begins after the last of them arrived, so it is as fresh as a separate one.
    """

    def __init__(
        self, *, most: int, most_bytes: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Make a queue with a limit of requests, a limit of their bytes, and a clock in seconds."""
        self._most, self._most_bytes, self._clock = most, most_bytes, clock
        self._groups: OrderedDict[Hashable, Group[Item]] = OrderedDict()
        self._busy_until: dict[Hashable, float] = {}
        self._count = self._bytes = 0
        self._changed = Condition()

    def __len__(self) -> int:
        """Count the waiting requests."""
        return self._count

    def offer(self, kind: Hashable, item: Item, *, size: int, turn: Hashable | None = None) -> bool:
        """Add a request; return false if there is no room for it.

        Args:
            kind: Equal for requests that one reply serves.
            item: The request.
            size: Its size, bytes.
            turn: Equal for requests that are answered one after the other; None: its kind.
        """
        with self._changed:
            group = self._groups.get(kind)
            if (
                self._count >= self._most
                or self._bytes + size > self._most_bytes
                or (group is not None and len(group.items) >= MOST_ALIKE)
            ):
                return False
            if group is None:
                group = self._groups[kind] = Group(kind if turn is None else turn)
            group.items.append(item)
            group.size += size
            self._count += 1
            self._bytes += size
            self._changed.notify()
            return True

    def take(self, *, timeout_s: float) -> Group[Item] | None:
        """Take the group of equal requests that has waited longest; call `done` after answering it.

        Groups whose turn is being answered are passed over; requests that join them get the next
        reply.

        Args:
            timeout_s: Longest wait for a group, seconds.

        Returns:
            All requests of one kind; None if none was available in time.
        """
        end_s = self._clock() + timeout_s
        with self._changed:
            while True:
                now_s = self._clock()
                for kind, group in self._groups.items():
                    if self._busy_until.get(group.turn, 0.0) <= now_s:
                        del self._groups[kind]
                        self._busy_until[group.turn] = math.inf
                        self._count -= len(group.items)
                        self._bytes -= group.size
                        return group
                if now_s >= end_s:
                    return None
                rests = (until for until in self._busy_until.values() if until > now_s)
                self._changed.wait(min(end_s, *rests, end_s) - now_s)

    def done(self, group: Group[Item], *, rest_s: float = 0.0) -> None:
        """Mark a group as answered; the next of its turn waits for `rest_s`."""
        with self._changed:
            now_s = self._clock()
            over = [turn for turn, until in self._busy_until.items() if until <= now_s]
            for turn in over:
                del self._busy_until[turn]
            if rest_s > 0:
                self._busy_until[group.turn] = now_s + rest_s
            else:
                del self._busy_until[group.turn]
            self._changed.notify()
