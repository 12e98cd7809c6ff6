"""The service alone in its process: at once, or as one of two after the other has ended."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from functools import partial
from threading import Event
from typing import Final

import structlog

from schemas.runtime.http_endpoint import HttpEndpoint
from schemas.runtime.process import stop_on_signals
from schemas.runtime.retry import StoppedError
from schemas.transport.bucket import Bucket, open_bucket
from service.assembly import (
    announce,
    enter_service,
    make_artifacts,
    metrics_at,
    notices_of,
    open_ledger,
    open_pages,
    wants_http,
)
from service.background.standby import Standby
from service.errors import DatabaseTakenError, StateInUseError, UsageError
from service.monitoring.gauges import Sources
from service.monitoring.http_pages import standby_pages
from service.monitoring.metrics import ServiceMetrics
from service.monitoring.readiness import Daemon
from service.security.listening import need_locked_bus, need_locked_pages, page_guard
from service.settings.config import DEFAULT_ENDPOINT, Settings
from service.store.engine import Store, StoreUnavailableError
from service.store.ledger import Ledger
from service.store.opening import sole_service
from service.store.single_writer_lock import SoleService
from service.store.state import StateLock, free_bytes, prepare_state

log = structlog.get_logger(__name__)

STOPPING: Final = (
    "stopping: open requests are answered; a second Ctrl-C ends at once, and nothing that was "
    "acknowledged is lost"
)
"""Remark on the first signal."""

_PAUSE_S: Final = 0.5


def run_service(settings: Settings, *, remark: Callable[[str], None]) -> None:
    """Run the service alone until a signal; it waits for its router.

    With `standby` it waits for its database too, and waits again when another service takes it.

    Raises:
        UsageError: If a standby has no database, or no artifacts that both services see.
    """
    connect = (settings.connect or DEFAULT_ENDPOINT).split(",")
    need_locked_bus(settings, connects=connect)
    need_locked_pages(settings, settings.http_listen, setting="http_listen")
    need_shared_places(settings)
    with stop_on_signals(partial(remark, STOPPING)) as stop, ExitStack() as opened:
        bucket = open_bucket(settings.bucket)
        prepare_state(settings.state)
        lock = opened.enter_context(StateLock(settings.state))
        serve = partial(_serve, settings, bucket, connect, lock, stop, remark=remark)
        if settings.standby:
            _serve_when_free(serve, stop)
        else:
            serve()


def need_shared_places(settings: Settings) -> None:
    """Refuse a standby that could not go on where the active service ends.

    Raises:
        UsageError: If it has no database, or no artifacts that both services see.
    """
    if settings.standby and not (settings.database and settings.artifacts):
        raise UsageError(
            "standby needs a database and artifacts that both services see: --database "
            "postgresql://user@host/name and --artifacts URL"
        )


def _serve_when_free(serve: Callable[[], None], stop: Event) -> None:
    while not stop.is_set():
        try:
            serve()
        except DatabaseTakenError as error:
            log.warning("withdrawn, standing by", problem=str(error))
        except (StoreUnavailableError, StateInUseError) as error:  # in the midst of a takeover
            log.warning("could not take over, standing by", problem=str(error))
            stop.wait(_PAUSE_S)


def _serve(
    settings: Settings,
    bucket: Bucket,
    connect: Sequence[str],
    lock: StateLock,
    stop: Event,
    *,
    remark: Callable[[str], None],
) -> None:
    with ExitStack() as opened:
        lock.announce("")
        try:
            sole = opened.enter_context(_sole(settings, stop, remark=remark))
        except StoppedError:  # while standing by
            return
        store, ledger = open_ledger(settings, opened, sole=sole)
        make_artifacts(settings)
        metrics = ServiceMetrics(vehicles=settings.vehicles)
        daemon = Daemon(router=f"waiting for a router at {', '.join(connect)}")
        http, notices = None, notices_of(settings, bucket)
        if wants_http(settings, once=False):  # before the router is there: it may take long
            metrics.read_from(_before_start(settings, bucket, ledger))
            http = open_pages(settings, daemon, ledger, opened, metrics.registry, notices=notices)
        try:
            service = enter_service(
                settings,
                ledger,
                bucket,
                connect,
                opened,
                stop=stop,
                sole=sole,
                metrics=metrics,
                locks=settings.locks,
                notices=notices,
            )
        except StoppedError:  # there never was a router
            return
        daemon.up(service)
        announce(lock, sole, ",".join(connect))
        where = ""
        if http is not None:
            opened.callback(http.close)  # no request may reach a closed service
            where = metrics_at(http)
        if settings.standby:
            where += f"; active under term {store.term}"
        remark(f"serving {bucket.url} over {', '.join(connect)}{where}")
        if settings.standby and sole is not None:
            service.run(stop, require=partial(_require_heard, sole, store))
        else:
            service.run(stop)


def _require_heard(sole: SoleService, store: Store) -> None:
    """Withdraw in time from a database that does not answer, so that a standby is alone."""
    try:
        sole.require_heard()
    except DatabaseTakenError:
        sole.shut()  # else the threads of the service would wait for it
        store.shut()
        raise


def _sole(
    settings: Settings, stop: Event, *, remark: Callable[[str], None]
) -> AbstractContextManager[SoleService | None]:
    """Take the exclusive right to serve, or stand by until it is free.

    Raises:
        StoppedError: If the standby was stopped.
    """
    if not settings.standby:
        return sole_service(settings)
    standby = Standby(settings.database, lease_s=settings.standby_after_s)
    with ExitStack() as opened:
        if wants_http(settings, once=False):
            guard = page_guard(settings)
            pages = standby_pages(standby)
            opened.enter_context(HttpEndpoint(settings.http_listen, pages, guard=guard))
        return standby.wait(stop, on_held=lambda: remark("standing by: another service is active"))


def _before_start(settings: Settings, bucket: Bucket, ledger: Ledger) -> Sources:
    """Return the sources of metrics until the service starts, as far as known without a router."""
    return Sources(
        backlog=ledger.backlog,
        bucket_url=bucket.url,
        state_free_bytes=partial(free_bytes, settings.state),
        now_s=ledger.now_s,
    )
