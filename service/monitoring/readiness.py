"""Whether the service can do its work now: what a load balancer or an orchestrator asks."""

from collections.abc import Mapping
from typing import Final, Protocol

import zenoh

from schemas.errors import CounterpointError, TransientError
from schemas.transport.bus import is_connected
from service.background.bucket_watch import BucketSeen
from service.store.ledger import Ledger

LISTINGS_MISSED: Final = 3
LISTING_GRACE_S: Final = 60.0
"""The bucket counts as out of sight after so many intervals and so much time without a listing."""


class Watched(Protocol):
    """What can be asked how it is, from any thread."""

    def check(self) -> None:
        """Raise what ended it, or a part of it."""
        ...

    def not_ready(self) -> Mapping[str, str]:
        """Say what keeps it from its work now, by part; empty: it is ready."""
        ...


class WatchedPool(Protocol):
    """A pool of workers, which can be asked how it is."""

    def check_alive(self) -> None:
        """Raise a `TransientError` if it no longer looks after its workers."""
        ...

    def check_ready(self) -> None:
        """Raise a `TransientError` if no worker could take a lease now."""
        ...


class Daemon:
    """A whole daemon as its pages see it: what its start waits for, then how its parts do."""

    def __init__(self, **waits_for: str) -> None:
        """Begin to start.

        Args:
            waits_for: A sentence for each part that the start may wait for.
        """
        self._waits_for: Mapping[str, str] = waits_for
        self._service: Watched | None = None
        self._pool: WatchedPool | None = None

    def up(self, service: Watched, pool: WatchedPool | None = None) -> None:
        """Nothing is waited for any more; ask these from now on."""
        self._pool, self._service = pool, service

    def check(self) -> None:
        """Raise what ended a part, if one has ended."""
        if self._service is not None:
            self._service.check()
        if self._pool is not None:
            self._pool.check_alive()

    def not_ready(self) -> dict[str, str]:
        """Say what keeps it from its work now, by part; empty: it is ready."""
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
    list_interval_s: float | None,
) -> dict[str, str]:
    """Say what keeps the service from its work.

    Args:
        ledger: Asked for one number, and whether its last write worked.
        session: On the bus.
        seen: What the listings of the bucket have shown.
        list_interval_s: Between two listings; None: there is only one, at the start.

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
    elif list_interval_s is not None:
        age_s = ledger.now_s() - seen.last_success_s
        if age_s > LISTING_GRACE_S + LISTINGS_MISSED * list_interval_s:
            why = seen.problem or "no listing has ended since"
            problems["bucket"] = f"the bucket was last listed {age_s:.0f} s ago: {why}"
    return problems
