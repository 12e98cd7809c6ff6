"""The worker's loop: claim, read, mine, publish, commit; killed at any point, nothing is lost.

A worker keeps no state. It publishes records on the bus and writes overlays to the artifacts during
mining. A commit then names them all, and the service answers it once everything is on disk. Work
without that answer is repeated, with the same bytes.
"""

import sys
import traceback
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from threading import Event
from typing import Final, Literal

import structlog
import zenoh

from schemas.errors import (
    BucketRefusedError,
    BucketUnreachableError,
    CounterpointError,
    ObjectChangedError,
    PermanentError,
)
from schemas.mining import MiningSettings
from schemas.runtime.retry import StoppedError, backoff_s, pause
from schemas.transport import keys
from schemas.transport.bus import client_session, recoverable_publisher
from schemas.transport.router_watch import RouterWatch
from schemas.work import FailRequest, Layers, MineLease, NothingToDo, PlanLease
from workers.ingest.footer import PredictionsAwaitedError, StillGrowingError
from workers.rescore import NotRescoredError
from workers.worker.acceptance import refusal
from workers.worker.config import WorkerConfig, WorkerObserver
from workers.worker.lease import LeaseKeeper, LeaseLostError, Leases
from workers.worker.lease_execution import Lease, LeaseExecution
from workers.worker.metrics import WorkerMetrics
from workers.worker.store_health import StoreTroubleError, cause_of, wait_until_over
from workers.worker.worker_context import WorkerContext, build_context

log = structlog.get_logger(__name__)

SharedOutcome = Literal["failed", "lost", "given_back", "replaced", "store_away"]
"""Ends of a lease that a plan and a shard have in common."""

FAIL_PATIENCE_S: Final = 20.0
LAST_PATIENCE_S: Final = 3.0
"""Time to report a failed lease, seconds, in normal operation and after a stop; the lease then
expires, with the same effect."""

FIRST_REFUSED_S: Final = 2.0
MOST_REFUSED_S: Final = 60.0
"""First and longest wait before a service that was not accepted is asked again, seconds: its
settings may change."""


def run_worker(
    config: WorkerConfig,
    *,
    stop: Event,
    observer: WorkerObserver | None = None,
    metrics: WorkerMetrics | None = None,
) -> None:
    """Work until stopped.

    Args:
        config: Configuration of the worker.
        stop: Set to end; a lease that is soon done is still finished.
        observer: Receives the state of the worker.
        metrics: Counters of the worker.

    Raises:
        TransientError: If bucket or artifacts cannot be opened now.
        PermanentError: If the service's settings can never be used here.
    """
    observer, metrics = observer or WorkerObserver(), metrics or WorkerMetrics()
    with (
        structlog.contextvars.bound_contextvars(worker_id=config.worker_id),
        client_session(config.connect, stop=stop, locks=config.locks) as session,
    ):
        alive = keys.live(root=config.root, role="worker", ident=config.worker_id)

        def router_seen(connected: bool) -> None:
            observer.connected(connected)
            metrics.router_seen(connected)

        with (
            session.liveliness().declare_token(alive),
            RouterWatch(session, router_seen),
        ):
            Worker(session, config, stop=stop, observer=observer, metrics=metrics).run()


class Worker:
    """One worker on one session."""

    def __init__(
        self,
        session: zenoh.Session,
        config: WorkerConfig,
        *,
        stop: Event,
        observer: WorkerObserver | None = None,
        metrics: WorkerMetrics | None = None,
    ) -> None:
        self._session, self._config, self._stop = session, config, stop
        self._observer = observer or WorkerObserver()
        self._metrics = metrics or WorkerMetrics()
        self._leases = Leases(
            session, root=config.root, worker_id=config.worker_id, is_named=config.is_named
        )
        self._context: WorkerContext | None = None
        self._suspect: tuple[str, str] | None = None
        self._refused = self._no_work = ""

    def run(self) -> None:
        """Claim and work until stopped."""
        key = keys.score(root=self._config.root, worker_id=self._config.worker_id)
        try:
            # one publisher for the worker's life: a router never forgets a declared key
            with recoverable_publisher(self._session, key) as publisher:
                execution = LeaseExecution(publisher, self._leases, self._metrics)
                while not self._stop.is_set():
                    self._claim_and_work(execution)
        except StoppedError:
            pass
        log.info("worker stops")

    def _claim_and_work(self, execution: LeaseExecution) -> None:
        context = self._current_context()
        layers = Layers.model_validate(asdict(context.layers))
        grant = self._leases.claim(context.version, layers=layers, stop=self._stop).grant
        if isinstance(grant, NothingToDo):
            if grant.problem and grant.problem != self._no_work:
                log.warning("no work for this worker", problem=grant.problem)
            self._no_work = grant.problem
            self._stop.wait(grant.retry_after_s)
            return
        self._observer.working(True)
        self._metrics.lease_began()
        store_trouble = self._work(execution, grant, context)
        self._metrics.lease_ended()
        self._observer.working(False)
        if store_trouble is not None:
            wait_until_over(store_trouble, stop=self._stop, metrics=self._metrics)

    def _current_context(self) -> WorkerContext:
        """Build parts and buckets if the settings changed; a restarted service may have others."""
        settings = self._accepted_settings()
        if self._context is None or self._context.settings != settings:
            self._context = build_context(settings)
            limit_threads()
            self._observer.equipped(self._context.version)
            log.info("worker ready", pipeline_version=self._context.version)
        return self._context

    def _accepted_settings(self) -> MiningSettings:
        """Request settings until this worker accepts them; log once why it does not.

        Raises:
            StoppedError: If stopped meanwhile.
        """
        waits = backoff_s(first_s=FIRST_REFUSED_S, most_s=MOST_REFUSED_S)
        settings = self._leases.hello(stop=self._stop)
        while problem := refusal(settings, self._config):
            if problem != self._refused:
                log.error("service not accepted, asking it again periodically", problem=problem)
                self._observer.equipped("")
            self._refused = problem
            pause(self._stop, next(waits))
            settings = self._leases.hello(stop=self._stop)
        if self._refused:
            log.info("service accepted")
            self._refused = ""
            if self._context is not None:
                self._observer.equipped(self._context.version)
        return settings

    def _work(
        self, execution: LeaseExecution, lease: Lease, context: WorkerContext
    ) -> StoreTroubleError | None:
        """Execute a lease, or report its failure; only a bug is raised, after it was reported.

        Returns:
            The trouble with a store that any other lease would also meet.
        """
        with (
            structlog.contextvars.bound_contextvars(**_ids(lease)),
            LeaseKeeper(
                self._leases,
                lease,
                stop=self._stop,
                drain_s=self._config.drain_s,
                on_unrenewed=self._metrics.renewal_failed,
            ) as keeper,
        ):
            log.debug("lease begins", lease_id=lease.lease_id)
            try:
                if isinstance(lease, PlanLease):
                    execution.plan(lease, context, keeper)
                elif lease.rescore is not None:
                    execution.rescore(lease, lease.rescore, context, keeper)
                else:
                    execution.mine(lease, context, keeper)
            except LeaseLostError as error:
                log.warning("work dropped", problem=str(error))
                self._count(lease, "lost")
            except (BucketUnreachableError, BucketRefusedError) as error:
                return self._fail_reading(error, lease, context)
            except CounterpointError as error:
                return self._fail(lease, error)
            except Exception as error:
                self._fail(lease, error)
                raise
            self._suspect = None
        return None

    def _fail_reading(
        self, error: CounterpointError, lease: Lease, context: WorkerContext
    ) -> StoreTroubleError | None:
        """Find the cause of a log that could not be read, and fail accordingly."""
        if self._stop.is_set():  # the next worker finds the cause
            return self._fail(lease, StoppedError(f"stopped while a store fails: {error}"))
        target = _target(lease)
        repeated, self._suspect = target == self._suspect, target
        cause = cause_of(
            *(error, context.bucket, lease.recording),
            repeated=repeated,
            predictions=context.settings.predictions,
        )
        return self._fail(lease, cause)

    def _fail(self, lease: Lease, error: Exception) -> StoreTroubleError | None:
        """Report to the service why a lease ended without its work.

        Returns:
            The error, if it is one that must be waited out.
        """
        problem = str(error) if isinstance(error, CounterpointError) else _summary(error)
        outcome = _outcome(error)
        is_plan = isinstance(lease, PlanLease)
        say = log.warning if outcome in ("failed", "replaced") else log.info
        if outcome in ("store_away", "growing", "awaits"):
            say = log.debug  # the wait for the store is logged; the service counts growing logs
        if outcome == "awaits" and isinstance(lease, PlanLease) and not lease.settled:
            log.info("log waits for its predictions", problem=problem)  # said once
        else:
            say(f"{'plan' if is_plan else 'shard'} {outcome.replace('_', ' ')}", problem=problem)
        match outcome:
            case "growing" | "awaits":
                self._metrics.plan_ended("growing")
            case "not_rescored":
                self._metrics.shard_ended("not_rescored")
            case _:
                self._count(lease, outcome)
        self._leases.fail(
            FailRequest(
                worker_id=self._config.worker_id,
                lease_id=lease.lease_id,
                error=problem,
                permanent=isinstance(error, PermanentError),
                replaced=outcome == "replaced",
                growing=outcome == "growing",
                awaits=outcome == "awaits",
                given_back=outcome in ("given_back", "store_away"),
                not_rescored=outcome == "not_rescored",
            ),
            patience_s=LAST_PATIENCE_S if self._stop.is_set() else FAIL_PATIENCE_S,
        )
        if isinstance(error, StoreTroubleError):
            self._metrics.store_failed(error.store, error.kind)
            return error
        return None

    def _count(self, lease: Lease, outcome: SharedOutcome) -> None:
        if isinstance(lease, PlanLease):
            self._metrics.plan_ended(outcome)
        else:
            self._metrics.shard_ended(outcome)


def _target(lease: Lease) -> tuple[str, str]:
    return lease.recording.log_id, lease.shard.name if isinstance(lease, MineLease) else ""


def _outcome(error: Exception) -> SharedOutcome | Literal["growing", "awaits", "not_rescored"]:
    match error:
        case StoppedError():
            return "given_back"
        case StoreTroubleError():
            return "store_away"
        case ObjectChangedError():
            return "replaced"
        case StillGrowingError():
            return "growing"
        case PredictionsAwaitedError():
            return "awaits"
        case NotRescoredError():
            return "not_rescored"
        case _:
            return "failed"


def _ids(lease: Lease) -> dict[str, str]:
    ids = {"log_id": lease.recording.log_id}
    return ids | {"shard": lease.shard.name} if isinstance(lease, MineLease) else ids


def _summary(error: Exception) -> str:
    """Summarise an error and its place in one line: a ledger is no place for a traceback."""
    frames: Sequence[traceback.FrameSummary] = traceback.extract_tb(error.__traceback__)
    where = "; ".join(f"{Path(f.filename).name}:{f.lineno} {f.name}" for f in frames[-3:])
    return f"{type(error).__name__}: {error} ({where})"


def limit_threads() -> None:
    """Limit torch to one thread: more cores are more workers, and results must not depend on them.

    Parts that need torch load it when they are built; without them it would only take 150 MiB.
    """
    if "torch" in sys.modules:
        import torch

        torch.set_num_threads(1)
