"""Leases that this process knows to be held, looked up for a request before it is decoded."""

import re
import threading
from collections import OrderedDict
from typing import Final

MOST_KNOWN: Final = 4096
"""Leases remembered, of which each worker process holds one or two."""

HEAD_BYTES: Final = 1024
"""Bytes of a message in which its lease is looked for: messages begin with worker and lease."""

_LEASE_ID: Final = re.compile(rb'"lease_id"\s*:\s*"([0-9a-f]{32})"')


class HeldLeases:
    """Ids of leases that were granted or renewed here, the least recently used forgotten first.

    A lease's id is 128 random bits that only its worker was given, so a request that names one is
    of that worker. The set decides in which lane a request waits and if the ledger is asked for the
    lease first, never how it is answered: after a restart a lease is unknown until its renewal.
    """

    def __init__(self) -> None:
        """Know none."""
        self._known: OrderedDict[str, None] = OrderedDict()
        self._lock = threading.Lock()

    def __contains__(self, lease_id: str) -> bool:
        """Return true if a lease is known to be held."""
        with self._lock:
            return lease_id in self._known

    def add(self, lease_id: str) -> None:
        """Remember a lease that was granted or renewed."""
        with self._lock:
            self._known[lease_id] = None
            self._known.move_to_end(lease_id)
            if len(self._known) > MOST_KNOWN:
                self._known.popitem(last=False)

    def discard(self, lease_id: str) -> None:
        """Forget a lease that is over."""
        with self._lock:
            self._known.pop(lease_id, None)

    def held_in(self, payload: bytes) -> str | None:
        """Return the held lease that a message names, not decoding it; None: it names none."""
        found = _LEASE_ID.search(payload[:HEAD_BYTES])
        if found is None:
            return None
        lease_id = found[1].decode()
        return lease_id if lease_id in self else None
