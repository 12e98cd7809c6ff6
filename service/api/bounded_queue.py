"""Bounded queue of requests waiting for a thread: it merges equal ones, and lanes take turns."""

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
        sizes: The size of each, bytes.
    """

    turn: Hashable
    items: deque[Item] = field(default_factory=deque)
    sizes: deque[int] = field(default_factory=deque)


@dataclass(slots=True)
class _Lane(Generic[Item]):
    """The waiting groups of one lane by kind, oldest first, with their requests and bytes."""

    groups: OrderedDict[Hashable, Group[Item]] = field(default_factory=OrderedDict)
    count: int = 0
    size: int = 0


class Waiting(Generic[Item]):
    """A queue that merges equal requests and takes one group of each lane in turn.

    A client that repeats a request faster than it is answered gets one reply for all of them. Work
    on that reply begins after the last of them arrived, so it is as fresh as a separate one.

    A flood of one lane delays each other lane by one answer a turn. A full queue sends back the
    newest request of its longest lane (stochastic fairness queueing: P. McKenney, INFOCOM 1990).
    """

    def __init__(
        self, *, most: int, most_bytes: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Make a queue with a limit of requests, a limit of their bytes, and a clock in seconds."""
        self._most, self._most_bytes, self._clock = most, most_bytes, clock
        self._lanes: OrderedDict[Hashable, _Lane[Item]] = OrderedDict()
        self._busy_until: dict[Hashable, float] = {}
        self._count = self._bytes = 0
        self._changed = Condition()

    def __len__(self) -> int:
        """Count the waiting requests."""
        return self._count

    def offer(
        self,
        kind: Hashable,
        item: Item,
        *,
        size: int,
        lane: Hashable = None,
        turn: Hashable | None = None,
    ) -> list[Item]:
        """Add a request, and return those that have no room: none, this one or others.

        Args:
            kind: Equal for requests that one reply serves; they are of one lane.
            item: The request.
            size: Its size, bytes.
            lane: Lanes are served in turn.
            turn: Equal for requests that are answered one after the other; None: its kind.
        """
        with self._changed:
            mine = self._lanes.get(lane) or _Lane[Item]()
            group = mine.groups.get(kind)
            if size > self._most_bytes or (group is not None and len(group.items) >= MOST_ALIKE):
                return [item]
            sent_back: list[Item] = []
            while self._count >= self._most or self._bytes + size > self._most_bytes:
                longest = self._longest_beside(mine, size=size)
                if longest is None:
                    return [*sent_back, item]
                sent_back.append(self._drop_newest(longest))
            self._lanes.setdefault(lane, mine)
            if group is None:
                group = mine.groups[kind] = Group(kind if turn is None else turn)
            group.items.append(item)
            group.sizes.append(size)
            self._note(mine, 1, size)
            self._changed.notify()
            return sent_back

    def take(self, *, timeout_s: float) -> Group[Item] | None:
        """Take the oldest group of the lane that waited longest; call `done` after answering it.

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
                group = self._take_now(now_s)
                if group is not None:
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

    def _take_now(self, now_s: float) -> Group[Item] | None:
        for name, lane in self._lanes.items():
            for kind, group in lane.groups.items():
                if self._busy_until.get(group.turn, 0.0) <= now_s:
                    self._busy_until[group.turn] = math.inf
                    del lane.groups[kind]
                    self._note(lane, -len(group.items), -sum(group.sizes))
                    if lane.groups:
                        self._lanes.move_to_end(name)
                    else:
                        del self._lanes[name]
                    return group
        return None

    def _longest_beside(self, mine: _Lane[Item], *, size: int) -> Hashable | None:
        """Find the lane that gives way: longer than `mine` would be, by what is scarce now."""
        by_count = self._count >= self._most
        length = {name: lane.count if by_count else lane.size for name, lane in self._lanes.items()}
        longest = max(length, key=length.__getitem__)
        own = mine.count + 1 if by_count else mine.size + size
        return longest if length[longest] > own else None

    def _drop_newest(self, name: Hashable) -> Item:
        lane = self._lanes[name]
        kind = next(reversed(lane.groups))
        group = lane.groups[kind]
        item = group.items.pop()
        self._note(lane, -1, -group.sizes.pop())
        if not group.items:
            del lane.groups[kind]
        if not lane.groups:
            del self._lanes[name]
        return item

    def _note(self, lane: _Lane[Item], count: int, size: int) -> None:
        lane.count += count
        lane.size += size
        self._count += count
        self._bytes += size
