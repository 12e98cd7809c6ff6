"""Ray pool: workers as actors of a Ray cluster, which places and restarts them.

Ray keeps actors alive, also when a node is lost. The ledger alone owns "done": the lease of a dead
worker expires, and another worker takes it.
"""

import math
import re
import signal
import socket
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Event, Thread, current_thread, main_thread
from types import TracebackType
from typing import Any, Final, Self

import structlog
from prometheus_client import CollectorRegistry

from schemas.errors import CounterpointError, PermanentError, TransientError
from schemas.transport.locks import OPEN, Locks
from workers.pool.process import LogStyle
from workers.pool.ray_actor import ActorState, RayWorker
from workers.worker.config import DRAIN_S, Accepted, WorkerConfig
from workers.worker.metrics import PoolMetrics

log = structlog.get_logger(__name__)

LOOK_S: Final = 1.0
ANSWER_S: Final = 5.0
"""Interval of questions to the actors, and time for their answers, seconds."""

SHRINK_S: Final = 60.0
"""Time for which fewer workers must suffice before some are ended, seconds."""

RESTARTS: Final = -1
"""Restarts of an actor by Ray: without end."""


@dataclass(frozen=True, slots=True)
class RayOptions:
    """Cluster and size of a pool.

    Attributes:
        address: Address of the cluster; `auto`: the one of this machine.
        least: Workers at least.
        most: Workers at most; between both the number follows the backlog.
        cpus: Cores of one worker, as a fraction or number.
        gpus: GPUs of one worker, as a fraction or number.
        resources: Custom resources that a node must offer, by name.
    """

    address: str = "auto"
    least: int = 1
    most: int = 1
    cpus: float = 1.0
    gpus: float = 0.0
    resources: dict[str, float] = field(default_factory=dict)


@dataclass(slots=True)
class _Member:
    worker_id: str
    actor: Any
    state: ActorState | None = None
    asked: Any = None
    asked_s: float = 0.0


class RayPool:
    """Keeps workers alive on a Ray cluster until it is stopped.

    Attributes:
        prefix: Prefix of the ids of its workers.
        registry: The pool's own metrics; those of the workers stay in their actors.
    """

    def __init__(
        self,
        options: RayOptions,
        *,
        connect: Sequence[str],
        root: str,
        name: str = "ray",
        drain_s: float = DRAIN_S,
        lease_deadline_s: float = 1800.0,
        style: LogStyle | None = None,
        accepts: Accepted | None = None,
        locks: Locks = OPEN,
        backlog: Callable[[], int] | None = None,
    ) -> None:
        """Connect to the cluster; `start` starts the workers.

        Args:
            options: Cluster and size.
            connect: Endpoints of routers, as the nodes of the cluster reach them.
            root: First part of every key.
            name: First part of the ids of its workers.
            drain_s: Time a stopping worker may continue with its lease, seconds.
            lease_deadline_s: The actor of a worker longer than this on one lease is restarted.
            style: Log style of the workers.
            accepts: Locations that a service may name, where a router is on another machine.
            locks: Certificates of the workers' sessions, at paths that exist on each node.
            backlog: Returns the number of plans and shards that wait or are leased; None: the pool
                keeps its least number of workers.

        Raises:
            PermanentError: If Ray is not installed.
            TransientError: If the cluster does not answer.
        """
        self._ray = connect_to(options.address)
        self.prefix = f"{name}-{_machine()}-{uuid.uuid4().hex[:12]}-"
        self._options, self._connect, self._root = options, tuple(connect), root
        self._drain_s, self._deadline_s = drain_s, lease_deadline_s
        self._style, self._accepts = style or LogStyle(), accepts or Accepted()
        self._locks, self._backlog = locks, backlog
        self._members: list[_Member] = []
        self._made = 0
        self._enough_since_s: float | None = None
        self.registry = CollectorRegistry()
        self._metrics = PoolMetrics(self.registry)
        self._metrics.alive.set_function(self.alive)
        self._stopping = Event()
        self._failure: Exception | None = None
        self._watcher = Thread(target=self._watch, name="pool", daemon=True)

    def start(self) -> None:
        """Start the least number of workers, and monitor them."""
        for _ in range(self._options.least):
            self._add()
        self._watcher.start()

    def size(self) -> int:
        """Return the number of workers that the pool keeps."""
        return len(self._members)

    def alive(self) -> int:
        """Count the workers that answered the last question."""
        return sum(member.state is not None for member in list(self._members))

    def pipeline_version(self) -> str:
        """Return the pipeline version of its workers; empty until the first of them is equipped."""
        versions = (member.state.version for member in list(self._members) if member.state)
        return next((version for version in versions if version), "")

    def check(self) -> None:
        """Raise the reason if nothing will be mined here any more.

        Raises:
            PermanentError: If every worker has given up; with the message of the first one.
            TransientError: If the pool no longer monitors its workers.
        """
        reasons = [member.state.gave_up if member.state else "" for member in list(self._members)]
        if reasons and all(reasons):
            raise PermanentError(reasons[0])
        self.check_alive()

    def check_alive(self) -> None:
        """Raise the reason if the pool no longer monitors its workers.

        Raises:
            TransientError: With the reason in one sentence.
        """
        if not self._stopping.is_set() and not self._watcher.is_alive():
            raise TransientError(f"the pool watches its workers no more: {self._failure!r}")

    def check_ready(self) -> None:
        """Raise the reason if no worker could take a lease now.

        Raises:
            TransientError: With the reason in one sentence.
        """
        self.check_alive()
        states = [member.state for member in list(self._members) if member.state is not None]
        if not any(state.connected and state.version for state in states):
            raise TransientError(
                "no worker of the Ray cluster is connected to a router and equipped; `ray status` "
                "says if the cluster has room for it"
            )

    def stop(self) -> None:
        """Ask the workers to finish nearly done work, and wait; then end their actors."""
        self._stopping.set()
        if self._watcher.ident is not None:
            self._watcher.join()
        self._end(self._members)
        self._members = []

    def __enter__(self) -> Self:
        """Start the workers."""
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop the workers."""
        self.stop()

    def _add(self) -> None:
        config = WorkerConfig(
            f"{self.prefix}{self._made}",
            self._connect,
            self._root,
            self._drain_s,
            self._accepts,
            self._locks,
        )
        self._made += 1
        actor = (
            self._ray.remote(RayWorker)
            .options(
                num_cpus=self._options.cpus,
                num_gpus=self._options.gpus,
                resources=self._options.resources or None,
                max_restarts=RESTARTS,
                max_task_retries=0,
                max_concurrency=2,  # a state is told while a stop waits
                scheduling_strategy="SPREAD",
            )
            .remote(config, self._style)
        )
        self._members.append(_Member(config.worker_id, actor))
        self._metrics.wanted.set(len(self._members))

    def _end(self, members: Sequence[_Member]) -> None:
        asked = [member.actor.stop.remote(self._drain_s) for member in members]
        if asked:
            self._ray.wait(asked, num_returns=len(asked), timeout=self._drain_s + ANSWER_S)
        for member in members:
            self._ray.kill(member.actor, no_restart=True)

    def _watch(self) -> None:
        """Monitor the workers; an exception is stored for `check_alive` to raise."""
        try:
            while not self._stopping.wait(LOOK_S):
                for member in self._members:
                    self._look(member)
                self._resize()
        except Exception as error:
            self._failure = error
            raise

    def _look(self, member: _Member) -> None:
        now_s = time.monotonic()
        if member.asked is None:
            member.asked, member.asked_s = member.actor.state.remote(), now_s
            return
        ready, _ = self._ray.wait([member.asked], timeout=0)
        if not ready:
            if now_s - member.asked_s > ANSWER_S:
                member.state = None  # it starts, or its node is lost
            return
        try:
            member.state = self._ray.get(member.asked)
        except self._ray.exceptions.RayError as error:
            if member.state is not None:
                log.warning("worker lost, Ray restarts it", worker_id=member.worker_id)
                log.debug("reason of the loss", problem=str(error))
                self._metrics.died("crashed")
            member.state = None
        member.asked = None
        if member.state is not None and member.state.lease_s > self._deadline_s:
            log.warning("worker stuck, its actor is restarted", worker_id=member.worker_id)
            self._metrics.died("stuck")
            self._ray.kill(member.actor, no_restart=False)
            member.state = None

    def _resize(self) -> None:
        """Follow the backlog: grow at once, shrink after a while and by idle workers only."""
        if self._backlog is None:
            return
        try:
            waiting = self._backlog()
        except CounterpointError:  # no service now: keep the size
            return
        wanted = wanted_size(waiting, self._options)
        now_s = time.monotonic()
        for _ in range(wanted - len(self._members)):
            self._add()
        if wanted >= len(self._members):
            self._enough_since_s = None
            return
        self._enough_since_s = self._enough_since_s or now_s
        if now_s - self._enough_since_s < SHRINK_S:
            return
        idle = [each for each in self._members if each.state is not None and not each.state.lease_s]
        going = idle[: len(self._members) - wanted]
        self._members = [each for each in self._members if each not in going]
        self._end(going)
        self._metrics.wanted.set(len(self._members))
        self._enough_since_s = None


def wanted_size(backlog: int, options: RayOptions) -> int:
    """Return the number of workers for a number of plans and shards, one each."""
    return max(options.least, min(options.most, math.ceil(backlog)))


def connect_to(address: str) -> Any:
    """Connect this process to a Ray cluster, and return the module.

    Raises:
        PermanentError: If Ray is not installed.
        TransientError: If the cluster does not answer.
    """
    try:
        import ray
    except ImportError:
        raise PermanentError(
            "the pool `ray` needs the extra of its name: pip install 'counterpoint[workers,ray]'"
        ) from None
    if not ray.is_initialized():
        try:
            with _own_signals():
                ray.init(address=address, log_to_driver=False, namespace="counterpoint")
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise TransientError(
                f"no Ray cluster answers at {address!r}: start one with `ray start --head`, or "
                f"name it with ray_address ({type(error).__name__})"
            ) from error
    return ray


@contextmanager
def _own_signals() -> Iterator[None]:
    """Keep the handlers of signals: Ray sets one that ends the process with exit code 15."""
    if current_thread() is not main_thread():  # Ray sets none there
        yield
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _machine() -> str:
    return re.sub(r"[^A-Za-z0-9_-]", "_", socket.gethostname())[:64] or "machine"
