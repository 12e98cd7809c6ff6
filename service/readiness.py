"""Whether the service can do its work now: what a load balancer or an orchestrator asks."""

from typing import Final

import zenoh

from schemas.bus import is_connected
from schemas.errors import CounterpointError
from service.bucket_watch import BucketSeen
from service.ledger import Ledger

LISTINGS_MISSED: Final = 3
LISTING_GRACE_S: Final = 60.0
"""The bucket counts as out of sight after so many intervals and so much time without a listing."""


def not_ready(
    ledger: Ledger,
    session: zenoh.Session,
    seen: BucketSeen,
    *,
    list_interval_s: float | None,
) -> dict[str, str]:
    """Say what keeps the service from its work.

    Args:
        ledger: Asked for one number.
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
    if not is_connected(session):
        problems["router"] = "no router is connected; scenes and leases wait for one"
    if seen.last_success_s is None:
        problems["bucket"] = "the bucket has not been listed yet"
    elif list_interval_s is not None:
        age_s = ledger.now_s() - seen.last_success_s
        if age_s > LISTING_GRACE_S + LISTINGS_MISSED * list_interval_s:
            problems["bucket"] = f"the bucket was last listed {age_s:.0f} s ago; the log says why"
    return problems
