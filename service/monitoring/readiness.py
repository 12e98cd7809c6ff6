"""Readiness of the service, for load balancers and orchestrators."""

from collections.abc import Mapping
from typing import Final, Protocol

import zenoh

from schemas.errors import CounterpointError, TransientError
from schemas.transport.bus import is_connected
from service.background.bucket_watch import BucketSeen
from service.store.ledger import Ledger

LISTINGS_MISSED: Final = 3
LISTING_GRACE_S: Final = 60.0
"""Grace period after several list intervals before the bucket counts as unreachable, seconds."""


class Watched(Protocol):
    """Interface of a service with liveness and readiness, callable from any thread."""

    def check(self) -> None:
        """Raise the error that ended it, or a part of it."""
        ...

    def not_ready(self) -> Mapping[str, str]:
        """Return the problems that keep it from its work now, by part; empty: it is ready."""
        ...


class WatchedPool(Protocol):
    """Interface of a pool of workers with liveness and readiness."""

    def check_alive(self) -> None:
        """Raise a `TransientError` if it no longer supervises its workers."""
        ...

    def check_ready(self) -> None:
        """Raise a `TransientError` if no worker could take a lease now."""
        ...


class Daemon:
    """Liveness and readiness of a daemon: first of its start, then of its parts."""

    def __init__(self, **waits_for: str) -> None:
        """Begin the start.

        Args:
            waits_for: A sentence for each part that the start may wait for.
        """
        self._waits_for: Mapping[str, str] = waits_for
        self._service: Watched | None = None
        self._pool: WatchedPool | None = None

    def up(self, service: Watched, pool: WatchedPool | None = None) -> None:
        """End the start; from now on these parts are asked."""
        self._pool, self._service = pool, service

    def check(self) -> None:
        """Raise the error that ended a part, if one has ended."""
        if self._service is not None:
            self._service.check()
        if self._pool is not None:
            self._pool.check_alive()

    def not_ready(self) -> dict[str, str]:
        """Return the problems that keep it from its work now, by part; empty: it is ready."""
        if self._service is None:
            return dict(self._waits_for)
        problems = dict(self._service.not_ready())
        if self._pool is not None:
            try:
                self._pool.check_ready()
            except TransientError as error:
                problems["workers"] = str(error)
        return problems


def not_ready(
    ledger: Ledger,
    session: zenoh.Session,
    seen: BucketSeen,
    *,
    listed_ago_s: float,
    list_interval_s: float | None,
) -> dict[str, str]:
    """Return the problems that keep the service from its work.

    Args:
        ledger: Queried for one number, and for the result of its last write.
        session: On the bus.
        seen: Results of the bucket's listings.
        listed_ago_s: Time since the last complete one by a clock that cannot be set, seconds.
        list_interval_s: Interval of listings, seconds; None: only one at the start.

    Returns:
        A sentence for each part that does not work: `database`, `router`, `bucket`. Empty: ready.
    """
    problems: dict[str, str] = {}
    try:
        ledger.last_seq()
    except CounterpointError as error:  # away, or damaged
        problems["database"] = str(error)
    else:
        if ledger.cannot_write:
            problems["database"] = f"can be read, but not written: {ledger.cannot_write}"
    if not is_connected(session):
        problems["router"] = "no router is connected; scenes and leases wait for one"
    if seen.last_success_s is None:
        problems["bucket"] = f"the bucket has not been listed yet; {seen.problem}".rstrip("; ")
    elif (
        list_interval_s is not None
        and listed_ago_s > LISTING_GRACE_S + LISTINGS_MISSED * list_interval_s
    ):
        why = seen.problem or "no listing has ended since"
        problems["bucket"] = f"the bucket was last listed {listed_ago_s:.0f} s ago: {why}"
    return problems
