"""Parts of the assembly that a whole machine and a service alone have in common."""

import time
from collections.abc import Sequence
from contextlib import ExitStack
from threading import Event

from prometheus_client import CollectorRegistry

from schemas.runtime.http_endpoint import HttpEndpoint
from schemas.transport.bucket import Bucket, open_bucket
from schemas.transport.bus import SERVICE_LINK_S, client_session
from schemas.transport.locks import OPEN, Locks
from service.app import Service
from service.background.bucket_notices import PATH as NOTICES_PATH
from service.background.bucket_notices import BucketNotices
from service.curation.priorities import Priorities
from service.errors import UsageError
from service.monitoring.http_pages import pages
from service.monitoring.metrics import ServiceMetrics
from service.monitoring.readiness import Daemon
from service.security.listening import page_guard
from service.settings.config import Settings
from service.store.engine import Store
from service.store.ledger import LeasePolicy, Ledger
from service.store.opening import open_ledger_store
from service.store.remining import ReminingPolicy
from service.store.single_writer_lock import SoleService
from service.store.state import StateLock


def make_artifacts(settings: Settings) -> None:
    """Make the place of overlays, so that one that cannot be written to ends the start."""
    open_bucket(settings.mining().artifacts, create=True)


def open_ledger(
    settings: Settings, opened: ExitStack, *, sole: SoleService | None, once: bool = False
) -> tuple[Store, Ledger]:
    """Open the database for writing, with the ledger in it; a PostgreSQL is beaten from now on."""
    store = open_ledger_store(settings, session_name="" if sole is None else sole.ident)
    opened.callback(store.close)
    if sole is not None:
        sole.begin(store.term, lease_s=settings.standby_after_s)
    policy = LeasePolicy(
        lease_s=settings.lease_s,
        max_attempts=settings.max_attempts,
        settle_s=0.0 if once else settings.settle_s,
    )
    ledger = Ledger(
        store,
        now_s=lambda: time.clock_gettime(time.CLOCK_REALTIME),
        policy=policy,
        remine=ReminingPolicy(
            settings.remine,
            settings.remine_core_hours_a_day,
            settings.remine_canary_share,
            Priorities.parse(settings.priorities),
        ),
    )
    return store, ledger


def announce(lock: StateLock, sole: SoleService | None, endpoint: str) -> None:
    """Publish the endpoint of the service where a second one looks for it."""
    lock.announce(endpoint)
    if sole is not None:
        sole.announce(endpoint)


def enter_service(
    settings: Settings,
    ledger: Ledger,
    bucket: Bucket,
    connect: Sequence[str],
    opened: ExitStack,
    *,
    stop: Event,
    sole: SoleService | None,
    metrics: ServiceMetrics,
    once: bool = False,
    locks: Locks = OPEN,
    notices: BucketNotices | None = None,
) -> Service:
    """Open a session on the bus, and serve through it."""
    link_s = SERVICE_LINK_S if settings.standby else None
    session = opened.enter_context(client_session(connect, stop=stop, locks=locks, link_s=link_s))
    return opened.enter_context(
        Service(
            settings,
            session,
            ledger,
            bucket=bucket,
            once=once,
            hold=None if sole is None else sole.check,
            takes_over=settings.standby,
            metrics=metrics,
            standbys=sole.standbys if settings.standby and sole is not None else None,
            notices=notices,
        )
    )


def open_pages(
    settings: Settings,
    daemon: Daemon,
    ledger: Ledger,
    opened: ExitStack,
    *registries: CollectorRegistry,
    notices: BucketNotices | None = None,
) -> HttpEndpoint:
    """Serve the HTTP pages of the service.

    Raises:
        TransientError: If the address is taken.
    """
    routes = pages(daemon, ledger, *registries)
    return opened.enter_context(
        HttpEndpoint(
            settings.http_listen,
            routes,
            guard=page_guard(settings),
            posts={} if notices is None else {NOTICES_PATH: notices.answer},
        )
    )


def notices_of(settings: Settings, bucket: Bucket, *, once: bool = False) -> BucketNotices | None:
    """Return the notices of the bucket that the HTTP pages take; None: it is listed.

    Raises:
        UsageError: If no page is served that could take them.
    """
    if not settings.bucket_notices:
        return None
    if once or not settings.http_listen:
        raise UsageError("bucket_notices needs a daemon with http_listen, where they arrive")
    return BucketNotices(bucket.url)


def metrics_at(endpoint: HttpEndpoint) -> str:
    """Return the URL of the metrics, as the end of a sentence."""
    return f"; metrics at {endpoint.url}/metrics"


def wants_http(settings: Settings, *, once: bool) -> bool:
    """Return true for a daemon, or for a run that ends by itself if an address was given for it."""
    asked_for = not once or "http_listen" in settings.model_fields_set
    return bool(settings.http_listen) and asked_for
