"""Expiry of leases, which spares those that no worker could have renewed in time."""

import time
from collections.abc import Callable
from typing import Final, Protocol

from service.background.clock_watch import ClockWatch

GAP_SHARE: Final = 1 / 3
"""Longest gap between two expiries as a share of a lease's term: a worker renews as often, so that
each lease lasts longer than such a gap."""

LEAST_GAP_S: Final = 5.0
"""Gap that is ordinary on a busy machine, seconds."""


class LeaseLedger(Protocol):
    """Ledger as far as leases end by time."""

    def resume(self) -> None:
        """Extend held leases to a full term."""
        ...

    def expire(self) -> int:
        """End leases whose time is over."""
        ...


class LeaseExpiry:
    """Ends leases of silent workers, unless the service itself could not hear them.

    After a step of the clock, an end by the clock before it says nothing. After an outage of the
    database, or a pause of this process, no renewal was taken. In both cases held leases last one
    full term more: else healthy work would be repeated and an attempt counted.
    """

    def __init__(
        self,
        ledger: LeaseLedger,
        clock: ClockWatch,
        *,
        lease_s: float,
        steady_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare.

        Args:
            ledger: The leases.
            clock: Looked at before each expiry.
            lease_s: Term of a lease, seconds.
            steady_s: Monotonic seconds.
        """
        self._ledger, self._clock, self._steady_s = ledger, clock, steady_s
        self._most_gap_s = max(LEAST_GAP_S, GAP_SHARE * lease_s)
        self._ended_s = steady_s()
        self._spares = False
        """True until leases are extended, also through failed attempts."""

    def expire(self) -> None:
        """End leases whose time is over; call each second.

        Raises:
            StoreUnavailableError: If the database does not answer now.
        """
        stepped = self._clock.look()
        if stepped or self._steady_s() - self._ended_s > self._most_gap_s:
            self._spares = True
        if self._spares:
            self._ledger.resume()
            self._spares = False
        self._ledger.expire()
        self._ended_s = self._steady_s()
