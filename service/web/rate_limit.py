"""Rate limit of requests: a token bucket for each client, in bounded memory."""

import time
from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Final

BURST_S: Final = 10.0
"""Requests at once, as seconds of the rate."""

WRITE_COST: Final = 10.0
"""Cost of a request that writes, in requests that read."""

MOST_CLIENTS: Final = 10_000
"""Clients that are counted; of more, those that have rested longest are forgotten."""


class RateLimit:
    """Allows each client a number of requests a second; may be asked from any thread."""

    def __init__(self, per_s: float, *, clock: Callable[[], float] = time.monotonic) -> None:
        """Keep the rate, requests a second; 0: no limit. The clock gives seconds."""
        self._per_s, self._clock = per_s, clock
        self._most = per_s * BURST_S
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self._lock = Lock()

    def __len__(self) -> int:
        """Count the clients that are remembered."""
        return len(self._left)

    def wait_s(self, client: str, *, cost: float = 1.0) -> float:
        """Take a request of a client; return 0, or how long it has to wait, seconds.

        Args:
            client: Name or address.
            cost: Cost of the request, in requests that read.
        """
        if self._per_s <= 0:
            return 0.0
        now_s = self._clock()
        with self._lock:
            left, at_s = self._left.pop(client, (self._most, now_s))
            left = min(self._most, left + (now_s - at_s) * self._per_s)
            allowed = left >= min(cost, self._most)
            self._left[client] = (left - cost if allowed else left, now_s)
            while len(self._left) > MOST_CLIENTS:
                self._left.popitem(last=False)
        return 0.0 if allowed else (min(cost, self._most) - left) / self._per_s
