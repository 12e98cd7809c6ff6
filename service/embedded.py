"""Assembly of processes: everything on one machine, or the service or the workers alone."""

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from functools import partial
from threading import Event
from typing import TYPE_CHECKING, Final

from prometheus_client import CollectorRegistry

from schemas.runtime.http_endpoint import HttpEndpoint
from schemas.runtime.process import stop_on_signals
from schemas.runtime.retry import StoppedError
from schemas.transport.bucket import Bucket, open_bucket
from schemas.transport.bus import check_endpoints, client_session, free_endpoint, router_session
from service.app import Service
from service.background.heartbeat import Heartbeat
from service.curation.status import Status
from service.errors import NothingFoundError
from service.monitoring.gauges import Sources
from service.monitoring.http_pages import pages
from service.monitoring.metrics import ServiceMetrics
from service.monitoring.readiness import Daemon
from service.settings.config import DEFAULT_ENDPOINT, Settings, cache_folder
from service.store.ledger import LeasePolicy, Ledger
from service.store.opening import open_ledger_store, sole_service
from service.store.single_writer_lock import SoleService
from service.store.state import StateLock, free_bytes, prepare_state

if TYPE_CHECKING:
    from workers.pool.local import LocalPool
    from workers.worker.config import Accepted

LOCAL_WORKERS: Final = "local-"
"""Prefix of the ids of workers that start and end with one `run`."""

_LOOK_S: Final = 0.5

DRAINING: Final = (
    "stopping: workers finish what is nearly done, for half a minute at most; a second Ctrl-C ends "
    "at once, and what is unfinished is mined again"
)
"""Remark on the first signal where workers run. No acknowledged work is lost by a second one."""

STOPPING: Final = (
    "stopping: open requests are answered; a second Ctrl-C ends at once, and nothing that was "
    "acknowledged is lost"
)
"""Remark on the first signal where the service runs alone."""

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
    """
    from workers.pool.local import LocalPool
    from workers.pool.process import LogStyle

    with ExitStack() as opened:
        stop = opened.enter_context(stop_on_signals(partial(remark, DRAINING)))
        bucket = open_bucket(settings.bucket)
        lock, sole, ledger = _open_state(settings, opened, once=once)
        _make_artifacts(settings)
        endpoint = settings.listen or free_endpoint()
        opened.enter_context(router_session([endpoint]))
        ledger.free_leases(LOCAL_WORKERS)
        service = _enter_service(
            settings,
            ledger,
            bucket,
            [endpoint],
            opened,
            stop=stop,
            sole=sole,
            once=once,
            metrics=ServiceMetrics(vehicles=settings.vehicles),
        )
        _announce(lock, sole, endpoint)
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
        )
        opened.callback(pool.stop)
        daemon = Daemon()
        daemon.up(service, pool)
        registries = (service.metrics.registry, pool.registry)
        where = ""
        if _wants_http(settings, once=once):
            where = _metrics_at(_open_pages(settings, daemon, ledger, opened, *registries))
        opened.enter_context(pool)
        remark(f"mining {bucket.url} with {settings.workers} workers; service at {endpoint}{where}")
        if page is not None:
            opened.enter_context(page)
        version = _stay(service, ledger, pool, stop, once=once, on_progress=on_progress)
        status = ledger.status(version or None)
    if once and not stop.is_set():
        _refuse_when_nothing_was_minable(status, bucket)
    return status


def run_service(settings: Settings, *, remark: Callable[[str], None]) -> None:
    """Run the service alone until a signal; it waits for its router."""
    connect = (settings.connect or DEFAULT_ENDPOINT).split(",")
    with ExitStack() as opened:
        stop = opened.enter_context(stop_on_signals(partial(remark, STOPPING)))
        bucket = open_bucket(settings.bucket)
        lock, sole, ledger = _open_state(settings, opened)
        _make_artifacts(settings)
        metrics = ServiceMetrics(vehicles=settings.vehicles)
        daemon = Daemon(router=f"waiting for a router at {', '.join(connect)}")
        http = None
        if _wants_http(settings, once=False):  # before the router is there: it may take long
            metrics.read_from(_before_start(settings, bucket, ledger))
            http = _open_pages(settings, daemon, ledger, opened, metrics.registry)
        try:
            service = _enter_service(
                settings,
                ledger,
                bucket,
                connect,
                opened,
                stop=stop,
                sole=sole,
                metrics=metrics,
            )
        except StoppedError:  # there never was a router
            return
        daemon.up(service)
        _announce(lock, sole, ",".join(connect))
        where = ""
        if http is not None:
            opened.callback(http.close)  # no request may reach a closed service
            where = _metrics_at(http)
        remark(f"serving {bucket.url} over {', '.join(connect)}{where}")
        service.run(stop)


def run_workers(settings: Settings, *, remark: Callable[[str], None]) -> None:
    """Run workers for a service elsewhere until a signal."""
    from workers.pool.local import LocalPool
    from workers.pool.pages import pool_pages
    from workers.pool.process import LogStyle

    connect = (settings.connect or DEFAULT_ENDPOINT).split(",")
    check_endpoints(connect)  # here, not by each worker that starts
    with ExitStack() as opened:
        stop = opened.enter_context(stop_on_signals(partial(remark, DRAINING)))
        pool = LocalPool(
            settings.workers,
            connect=connect,
            root=settings.root,
            home=cache_folder(),
            lease_deadline_s=settings.shard_deadline_s,
            style=LogStyle(settings.log_level, settings.log_format == "json"),
            name="worker",
            accepts=accepted_by(settings),
        )
        opened.callback(pool.stop)
        where = ""
        if listen := settings.worker_http_listen:
            http = HttpEndpoint(listen, pool_pages(pool), setting="worker_http_listen")
            where = _metrics_at(opened.enter_context(http))
        opened.enter_context(pool)
        remark(f"{settings.workers} workers for the service at {', '.join(connect)}{where}")
        heartbeat = Heartbeat(lambda: {"workers": pool.alive()}, heartbeat_s=settings.heartbeat_s)
        while not stop.wait(_LOOK_S):
            pool.check()
            heartbeat.beat()


def accepted_by(settings: Settings) -> "Accepted":
    """Return the locations that workers with these settings accept from a service elsewhere."""
    from workers.worker.config import Accepted

    return Accepted(
        settings.bucket,
        settings.artifacts_url,
        settings.model,
        settings.weights,
        settings.predictions,
    )


def _make_artifacts(settings: Settings) -> None:
    """Make the place of overlays, so that one that cannot be written to ends the start."""
    open_bucket(settings.mining().artifacts, create=True)


def _open_state(
    settings: Settings, opened: ExitStack, *, once: bool = False
) -> tuple[StateLock, SoleService | None, Ledger]:
    prepare_state(settings.state)
    lock = opened.enter_context(StateLock(settings.state))
    sole = opened.enter_context(sole_service(settings))
    store = open_ledger_store(settings)
    opened.callback(store.close)
    policy = LeasePolicy(
        lease_s=settings.lease_s,
        max_attempts=settings.max_attempts,
        settle_s=0.0 if once else settings.settle_s,
    )
    ledger = Ledger(store, now_s=lambda: time.clock_gettime(time.CLOCK_REALTIME), policy=policy)
    return lock, sole, ledger


def _announce(lock: StateLock, sole: SoleService | None, endpoint: str) -> None:
    lock.announce(endpoint)
    if sole is not None:
        sole.announce(endpoint)


def _enter_service(
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
) -> Service:
    session = opened.enter_context(client_session(connect, stop=stop))
    return opened.enter_context(
        Service(
            settings,
            session,
            ledger,
            bucket=bucket,
            once=once,
            hold=None if sole is None else sole.check,
            metrics=metrics,
        )
    )


def _before_start(settings: Settings, bucket: Bucket, ledger: Ledger) -> Sources:
    """Return the sources of metrics until the service starts, as far as known without a router."""
    return Sources(
        backlog=ledger.backlog,
        bucket_url=bucket.url,
        state_free_bytes=partial(free_bytes, settings.state),
        now_s=ledger.now_s,
    )


def _open_pages(
    settings: Settings,
    daemon: Daemon,
    ledger: Ledger,
    opened: ExitStack,
    *registries: CollectorRegistry,
) -> HttpEndpoint:
    """Serve the HTTP pages of the service.

    Raises:
        TransientError: If the address is taken.
    """
    routes = pages(daemon, ledger, *registries)
    return opened.enter_context(HttpEndpoint(settings.http_listen, routes))


def _metrics_at(endpoint: HttpEndpoint) -> str:
    """Return the URL of the metrics, as the end of a sentence."""
    return f"; metrics at {endpoint.url}/metrics"


def _wants_http(settings: Settings, *, once: bool) -> bool:
    """Return true for a daemon, or for a run that ends by itself if an address was given for it."""
    asked_for = not once or "http_listen" in settings.model_fields_set
    return bool(settings.http_listen) and asked_for


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
    states = {log.state for log in status.logs}
    if states == {"refused"}:
        first = status.logs[0]
        raise NothingFoundError(
            f"no log in {bucket.url} can be mined; {first.log_id}: {first.problem}"
        )
