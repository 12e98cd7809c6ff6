"""Ranking service: the assembly of all its parts; the entry point for readers.

    bucket watch ─► ledger ◄─ control (claim, commit, …) ◄─ workers
                      │                    ▲
                      │                staging ◄─ score/** (raw records on the bus)
                      ├─► outbox ─► scene/** (durable, numbered)
                      ├─► history ─► late subscribers
                      └─► ranking, selection ─► top, select, selected/**

Only the ledger is durable; everything else may be killed at any moment and is rebuilt from it.
"""

from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from functools import partial
from threading import Event
from types import TracebackType
from typing import Any, Final, Self

import structlog
import zenoh

from schemas.errors import BucketRefusedError, TransientError
from schemas.transport import keys
from schemas.transport.bucket import Bucket
from schemas.transport.bus import is_connected, recoverable_subscriber
from schemas.transport.router_watch import RouterWatch
from service.api.control import Control
from service.api.expected_versions import ExpectedVersions
from service.api.history import History
from service.api.outbox import Outbox
from service.api.request_queue import RequestQueue
from service.api.staging import Staging
from service.background.bucket_notices import BucketNotices
from service.background.bucket_watch import BucketWatch
from service.background.clock_watch import ClockWatch
from service.background.heartbeat import Heartbeat, Standing, service_standing
from service.background.lease_expiry import LeaseExpiry
from service.background.mode_watch import ModeWatch
from service.background.overlay_sweeps import overlay_sweeps
from service.background.periodic import tick
from service.background.webhook_terms import webhook_terms
from service.background.webhooks import WebhookDelivery
from service.curation.comparison import Comparison
from service.curation.webhooks import gate_notice
from service.errors import StateInUseError, StatementFailedError
from service.monitoring.gauges import Sources
from service.monitoring.metrics import ServiceMetrics
from service.monitoring.readiness import not_ready
from service.settings.config import Settings
from service.store.ledger import Ledger
from service.store.state import free_bytes

log = structlog.get_logger(__name__)

WRITING_THREADS: Final = 16
"""Threads that answer writing requests. Commits that wait for the disk at the same time share one
transaction, so more threads mean fewer waits; beyond this number the processor limits.
"""

READING_THREADS: Final = 4
"""Threads that answer reading requests, so that a long answer does not delay short ones."""

THREADS: Final = WRITING_THREADS + READING_THREADS + 8
"""All threads of the service. Eight do background work: bucket watch, notices of it, expiry of
leases, outbox, heartbeat, two deletions of overlays, and the hold on the database.
"""

NOTICES_INTERVAL_S: Final = 0.5
"""Interval at which named objects are looked up, all that have come together, seconds."""

EXPIRY_INTERVAL_S: Final = 1.0
EXPIRY_RETRY_S: Final = 5.0
"""Interval of test writes after a failed one, by which an idle daemon sees a recovery, seconds."""

HOLD_INTERVAL_S: Final = 1.0
_TAKEOVER_WAITS_S: Final = (0.1,) * 200
"""Waits for the token of a frozen service, which its router drops after `SERVICE_LINK_S`."""

OUTBOX_INTERVAL_S: Final = 0.5
"""Interval of publishing without an alarm, seconds, since a router may have come back."""


_PASSING: Final = (TransientError, StatementFailedError)
"""Errors that may pass; a refused statement is a fault of the request, not of the service."""


class Service:
    """Watches the bucket, answers workers and publishes scenes, within a `with` block.

    Session, ledger and buckets belong to the caller; they must outlive the block.

    Attributes:
        metrics: Counters and gauges, read at a scrape.
    """

    def __init__(
        self,
        settings: Settings,
        session: zenoh.Session,
        ledger: Ledger,
        *,
        bucket: Bucket,
        once: bool = False,
        hold: Callable[[], object] | None = None,
        takes_over: bool = False,
        metrics: ServiceMetrics | None = None,
        standbys: Callable[[], int] | None = None,
        notices: BucketNotices | None = None,
    ) -> None:
        """Wire the parts; nothing happens before the block is entered.

        Args:
            settings: Settings of this process, and those that every worker shares.
            session: On the bus.
            ledger: Durable state.
            bucket: The log bucket, which is only listed.
            once: List the bucket only at the start, unless an object changes under a reader, and
                believe at once that it is empty.
            hold: Checks that this service is still the only writer of the ledger; None: that cannot
                change.
            takes_over: Another service may have served this state a moment ago: wait until the
                bus has lost it, and list the bucket once requests are answered.
            metrics: Receives all counts; None: a private set.
            standbys: Counts the standbys of this service; None: it has none.
            notices: Notices of changed objects; with them the bucket is rarely listed.

        Raises:
            UsageError: If overlays are to be deleted in the log bucket, or webhooks have no secret.
        """
        self._session, self._ledger, self._root = session, ledger, settings.root
        self._list_interval_s, self._once = settings.list_interval_s, once
        self._notices = notices
        if notices is not None:
            self._list_interval_s = settings.notified_list_interval_s
        self._stop, self._news = Event(), Event()
        self._hold, self._takes_over = hold, takes_over
        self._watch = BucketWatch(
            bucket,
            ledger,
            include=settings.include,
            exclude=settings.exclude,
            settle_s=0.0 if once else settings.settle_s,
        )
        self._heartbeat = Heartbeat(self._standing, heartbeat_s=settings.heartbeat_s)
        self._staging = Staging()
        self._clock = ClockWatch()
        self._expiry = LeaseExpiry(ledger, self._clock, lease_s=settings.lease_s)
        mining = settings.mining()
        self._sweeps, self._budget = overlay_sweeps(settings, ledger, log_bucket_url=bucket.url)
        self.metrics = metrics or ServiceMetrics()
        ledger.observe(self.metrics)
        self._outbox = Outbox(
            session, ledger, root=self._root, on_fault=partial(self.metrics.faulted, "event")
        )
        self._history = History(session, ledger, root=self._root)
        self._control = Control(
            settings=mining,
            ledger=ledger,
            staging=self._staging,
            on_scenes=self._news.set,
            on_selection=self._outbox.publish_selection,
            on_commit_seconds=self.metrics.committed,
            on_comparison=self._compared,
            causes=settings.causes,
            versions=ExpectedVersions(
                settings.expected_versions,
                takes_any=settings.is_on_loopback,
                known=ledger.pipeline_versions,
            ),
        )
        self._requests = RequestQueue(
            session,
            leases=self._control.leases,
            names_proved=settings.locks.is_set,
            on_outcome=self.metrics.asked,
            on_fault=partial(self.metrics.faulted, "request"),
        )
        self._webhooks = WebhookDelivery(
            ledger.webhooks,
            terms := webhook_terms(settings),
            now_s=ledger.now_s,
            on_outcome=self.metrics.webhook,
        )
        self._notes_comparisons = terms.wants("gate.compared")
        self._modes = (
            ModeWatch(ledger, on_new=self.metrics.new_modes) if terms.wants("mode.new") else None
        )
        self.metrics.read_from(
            Sources(
                backlog=ledger.backlog,
                bucket_url=bucket.url,
                bucket=lambda: self._watch.seen,
                staging_bytes=lambda: self._staging.waiting_bytes,
                questions_waiting=lambda: self._requests.waiting,
                bus_misses=lambda: self._staging.missed,
                state_free_bytes=partial(free_bytes, settings.state),
                router_connected=lambda: is_connected(session),
                clock_steps=lambda: self._clock.steps,
                bucket_notices=lambda: None if notices is None else notices.taken,
                overlays_deleted=lambda: sum(each.deleted for each in self._sweeps),
                artifacts=lambda: self._budget,
                webhooks_late_s=lambda: self._webhooks.late_s,
                standbys=standbys or (lambda: None),
                now_s=ledger.now_s,
            )
        )
        self._open = ExitStack()
        self._threads: list[Future[None]] = []

    def _compared(self, found: Comparison) -> None:
        """Count a comparison, and note it for the receivers of webhooks."""
        self.metrics.compared(not found.passed)
        if self._notes_comparisons:
            name, body = gate_notice(found)
            self._ledger.webhooks.note("gate", {name: body})

    @property
    def recordings(self) -> int:
        """Number of recordings in the last listing of the bucket."""
        return self._watch.recordings or 0

    def __enter__(self) -> Self:
        """List the bucket, then answer.

        Raises:
            BucketUnreachableError: If the store does not answer; after the start the service waits
                for it.
            BucketRefusedError: If the store refuses.
            OtherBucketError: If the ledger belongs to another bucket.
            StateInUseError: If another service answers under this root.
        """
        self._be_alone()
        self._ledger.resume()
        if not self._takes_over:
            self._watch.list_once()
        with ExitStack() as opening:
            pool = opening.enter_context(ThreadPoolExecutor(THREADS, thread_name_prefix="service"))
            opening.callback(self._end)
            opening.enter_context(RouterWatch(self._session, lambda _: self._news.set()))
            opening.enter_context(
                recoverable_subscriber(
                    self._session,
                    keys.all_scores(root=self._root),
                    self._staging.on_sample,
                    on_miss=self._staging.on_miss,
                )
            )
            opening.callback(self._requests.close)
            self._control.declare(self._requests, root=self._root)
            self._history.declare(self._requests)
            opening.enter_context(
                self._session.liveliness().declare_token(
                    keys.live(root=self._root, role="service", ident=str(self._session.zid()))
                )
            )
            opening.enter_context(self._webhooks)
            if self._modes is not None:
                opening.enter_context(self._modes)
            self._start(pool)
            self._open = opening.pop_all()
        log.info("service up", root=self._root, recordings=self._watch.recordings)
        return self

    def not_ready(self) -> dict[str, str]:
        """Return the problems that keep the service from its work, by part; empty: it is ready."""
        return not_ready(
            self._ledger,
            self._session,
            self._watch.seen,
            listed_ago_s=self._watch.age_s(),
            list_interval_s=None if self._once else self._list_interval_s,
        )

    def check(self) -> None:
        """Raise the error that ended a thread of the service, if one has ended."""
        for thread in wait(self._threads, timeout=0, return_when=FIRST_EXCEPTION).done:
            if (error := thread.exception()) is not None:
                log.error("the service ends", problem=str(error))  # before workers are waited for
                raise error

    def run(self, stop: Event, *, require: Callable[[], object] = lambda: None) -> None:
        """Wait until `stop` is set, or until a thread ends, whose error is raised.

        Args:
            stop: Ends the wait.
            require: Called twice a second; raises an error to end the service.
        """
        while not stop.wait(0.5):
            self.check()
            require()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Refuse new requests, and end every thread."""
        self._open.close()
        log.info("service down", root=self._root)

    def _be_alone(self) -> None:
        """Refuse to start next to another service under this root.

        Both would grant leases, each from a ledger of its own.
        """
        others = keys.all_live(root=self._root, role="service")
        waits_s = (0.1, 0.4, 1.0, 2.0, 0.0)  # one that was just killed is gone in a moment
        for wait_s in (*_TAKEOVER_WAITS_S, 0.0) if self._takes_over else waits_s:
            if not any(reply.ok for reply in self._session.liveliness().get(others, timeout=5)):
                return
            self._stop.wait(wait_s)
        raise StateInUseError(
            f"another service answers under {self._root!r} on this router; "
            "stop it, or give this one a root of its own"
        )

    def _start(self, pool: ThreadPoolExecutor) -> None:
        of_bucket = (*_PASSING, BucketRefusedError)  # credentials are renewed, policies mended

        def every(
            interval_s: float, call: Callable[[], object], what: str, **options: Any
        ) -> Future[None]:
            options = {"passing": _PASSING} | options
            fault = partial(self.metrics.faulted, "tick")
            return pool.submit(
                tick,
                call,
                what=what,
                interval_s=interval_s,
                stop=self._stop,
                on_fault=fault,
                **options,
            )

        listing = self._list_what_changed if self._once else self._list_in_time
        self._threads = [
            pool.submit(self._requests.serve, self._stop, writes=number < WRITING_THREADS)
            for number in range(WRITING_THREADS + READING_THREADS)
        ]
        expire = self._expiry.expire
        self._threads += [
            every(EXPIRY_INTERVAL_S, expire, "expiry of leases", most_retry_s=EXPIRY_RETRY_S),
            every(
                OUTBOX_INTERVAL_S, self._outbox.publish, "publishing of scenes", alarm=self._news
            ),
            every(self._list_interval_s, listing, "listing of the bucket", passing=of_bucket),
            every(self._heartbeat.interval_s, self._heartbeat.beat, "heartbeat"),
        ]
        if self._notices is not None:
            look = partial(self._look_at_named, self._notices)
            what = "looking up of named objects"
            self._threads.append(every(NOTICES_INTERVAL_S, look, what, passing=of_bucket))
        for sweep in self._sweeps:
            delete = partial(sweep.sweep, self._stop)
            what = "deletion of overlays"
            self._threads.append(every(sweep.interval_s, delete, what, passing=of_bucket))
        if self._hold is not None:
            what = "hold on the database"
            self._threads.append(
                every(HOLD_INTERVAL_S, self._hold, what, most_retry_s=HOLD_INTERVAL_S)
            )

    def _list_in_time(self) -> None:
        """List the bucket; one that sends notices was listed at the start, and is due later."""
        if self._notices is None or self._watch.age_s() > 0.5 * self._list_interval_s:
            self._watch.list_once()

    def _look_at_named(self, notices: BucketNotices) -> None:
        """Look up the objects that notices named; those that cannot be, wait."""
        keys = notices.drain()
        try:
            if keys is None:
                self._watch.list_once()
            elif keys:
                self._watch.look_at(keys)
        except Exception:
            notices.give_back(keys)
            raise

    def _standing(self) -> Standing:
        return service_standing(
            self._ledger, self._session, root=self._root, listed_ago_s=self._watch.age_s()
        )

    def _list_what_changed(self) -> None:
        """List the bucket again if an object changed under its reader.

        Its work would otherwise wait for ever.
        """
        if self._ledger.stale_logs():
            self._watch.list_once()

    def _end(self) -> None:
        self._stop.set()
        self._news.set()
