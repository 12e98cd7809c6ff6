"""Assembly of processes: everything on one machine, or the workers alone."""

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from functools import partial
from threading import Event
from typing import TYPE_CHECKING, Final

from schemas.runtime.http_endpoint import HttpEndpoint
from schemas.runtime.process import stop_on_signals
from schemas.transport.bucket import Bucket, open_bucket
from schemas.transport.bus import check_endpoints, free_endpoint, router_session
from schemas.transport.endpoints import from_here
from schemas.transport.locks import check_locks
from service.app import Service
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
from service.background.heartbeat import Heartbeat
from service.curation.status import Status
from service.errors import NothingFoundError, UsageError
from service.monitoring.metrics import ServiceMetrics
from service.monitoring.readiness import Daemon
from service.security.listening import need_locked_bus, need_locked_pages, page_guard
from service.settings.config import DEFAULT_ENDPOINT, Settings
from service.store.ledger import Ledger
from service.store.opening import sole_service
from service.store.state import StateLock, prepare_state
from service.worker_pools import accepted_by, local_pool, ray_pool

if TYPE_CHECKING:
    from workers.pool.local import LocalPool

LOCAL_WORKERS: Final = "local-"
"""Prefix of the ids of workers that start and end with one `run`."""

_LOOK_S: Final = 0.5

DRAINING: Final = (
    "stopping: workers finish what is nearly done, for half a minute at most; a second Ctrl-C ends "
    "at once, and what is unfinished is mined again"
)
"""Remark on the first signal where workers run. No acknowledged work is lost by a second one."""

_STARTING: Final = "workers start; the first run compiles its loops, which takes about a minute"


def run_embedded(
    settings: Settings,
    *,
    once: bool,
    remark: Callable[[str], None],
    on_progress: Callable[[str, int, int | None], None],
    page: AbstractContextManager[None] | None = None,
) -> Status:
    """Run router, service and workers of one machine until a signal, or until all is mined.

    Args:
        settings: Bucket, state, workers, and the settings that workers share.
        once: Stop when every log now in the bucket is done, refused or parked.
        remark: Called with a sentence that names the endpoint of the service, and with one when a
            signal stops the run.
        on_progress: Called at intervals with the current step, the shards finished, and the shards
            in total, if known.
        page: Entered once the service answers, and left first at the end: the review page.

    Returns:
        Status of the ledger at the end.

    Raises:
        NothingFoundError: With `once`, if the bucket has no log, or no log has a lidar.
        BucketRefusedError: If the folder of logs or predictions does not exist.
        UsageError: With `standby`, since a second one would take its endpoint too.
    """
    if settings.standby:
        raise UsageError("standby is for `counterpoint service`, beside a router of its own")
    from workers.ingest.prediction_files import open_predictions
    from workers.pool.local import LocalPool
    from workers.pool.process import LogStyle

    if settings.predictions:
        open_predictions(settings.predictions)
    with ExitStack() as opened:
        stop = opened.enter_context(stop_on_signals(partial(remark, DRAINING)))
        bucket = open_bucket(settings.bucket)
        prepare_state(settings.state)
        lock = opened.enter_context(StateLock(settings.state))
        sole = opened.enter_context(sole_service(settings))
        _, ledger = open_ledger(settings, opened, sole=sole, once=once)
        make_artifacts(settings)
        listens = (settings.listen or free_endpoint()).split(",")
        need_locked_bus(settings, listens=listens)
        opened.enter_context(router_session(listens, locks=settings.locks))
        endpoint = from_here(listens[0])
        ledger.free_leases(LOCAL_WORKERS)
        service = enter_service(
            settings,
            ledger,
            bucket,
            [endpoint],
            opened,
            stop=stop,
            sole=sole,
            once=once,
            metrics=ServiceMetrics(vehicles=settings.vehicles),
            locks=settings.client_locks,
            notices=(notices := notices_of(settings, bucket, once=once)),
        )
        announce(lock, sole, endpoint)
        if once and not service.recordings:
            raise NothingFoundError(f"no .mcap log in {bucket.url}")
        pool = LocalPool(
            settings.workers,
            connect=[endpoint],
            root=settings.root,
            home=settings.state,
            lease_deadline_s=settings.shard_deadline_s,
            style=LogStyle(settings.log_level, settings.log_format == "json"),
            on_death=lambda worker_id: _take_back(ledger, worker_id),
            accepts=accepted_by(settings),
            locks=settings.client_locks,
        )
        opened.callback(pool.stop)
        daemon = Daemon()
        daemon.up(service, pool)
        registries = (service.metrics.registry, pool.registry)
        where = ""
        if wants_http(settings, once=once):
            where = metrics_at(
                open_pages(settings, daemon, ledger, opened, *registries, notices=notices)
            )
        opened.enter_context(pool)
        at = ", ".join(listens)
        remark(f"mining {bucket.url} with {settings.workers} workers; service at {at}{where}")
        if page is not None:
            opened.enter_context(page)
        version = _stay(service, ledger, pool, stop, once=once, on_progress=on_progress)
        status = ledger.status(version or None)
    if once and not stop.is_set():
        _refuse_when_nothing_was_minable(status, bucket)
    return status


def run_workers(settings: Settings, *, remark: Callable[[str], None]) -> None:
    """Run workers for a service elsewhere until a signal."""
    from workers.pool.pages import pool_pages

    connect = (settings.connect or DEFAULT_ENDPOINT).split(",")
    check_endpoints(connect)  # here, not by each worker that starts
    check_locks(settings.locks, tuple(connect))
    need_locked_bus(settings, connects=connect)
    need_locked_pages(settings, settings.worker_http_listen, setting="worker_http_listen")
    with ExitStack() as opened:
        stop = opened.enter_context(stop_on_signals(partial(remark, DRAINING)))
        is_ray = settings.pool == "ray"
        pool = (ray_pool if is_ray else local_pool)(settings, connect, opened, stop)
        opened.callback(pool.stop)
        where = ""
        if listen := settings.worker_http_listen:
            http = HttpEndpoint(
                listen,
                pool_pages(pool),
                setting="worker_http_listen",
                guard=page_guard(settings),
            )
            where = metrics_at(opened.enter_context(http))
        opened.enter_context(pool)
        on = " on Ray" if is_ray else ""
        remark(f"{settings.workers} workers{on} for the service at {', '.join(connect)}{where}")
        heartbeat = Heartbeat(lambda: {"workers": pool.alive()}, heartbeat_s=settings.heartbeat_s)
        while not stop.wait(_LOOK_S):
            pool.check()
            heartbeat.beat()


def _stay(
    service: Service,
    ledger: Ledger,
    pool: "LocalPool",
    stop: Event,
    *,
    once: bool,
    on_progress: Callable[[str, int, int | None], None],
) -> str:
    """Supervise service and pool until a signal or, with `once`, until all work is settled.

    Returns:
        With `once`, the pipeline version of the pool's workers; empty if none got that far.
    """
    version = ""
    while not stop.wait(_LOOK_S):
        service.check()
        pool.check()
        version = pool.pipeline_version() or version
        if once and version and ledger.settled(version):
            break
        works = ledger.backlog().work.items()  # cheap, unlike a whole status
        shards = {state: count for (kind, state), count in works if kind == "shard"}
        finished = shards.get("done", 0) + shards.get("parked", 0)
        on_progress("mining" if version else _STARTING, finished, sum(shards.values()) or None)
    return version if once else ""


def _take_back(ledger: Ledger, worker_id: str) -> None:
    ledger.worker_died(worker_id)


def _refuse_when_nothing_was_minable(status: Status, bucket: Bucket) -> None:
    refused = [log for log in status.logs if log.state == "refused"]
    others = {log.state for log in status.logs} - {"refused", "same"}
    if refused and not others:
        first = refused[0]
        raise NothingFoundError(
            f"no log in {bucket.url} can be mined; {first.log_id}: {first.problem}"
        )
