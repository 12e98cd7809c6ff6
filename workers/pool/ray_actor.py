"""Ray actor with one worker: its loop in a thread, its state on request."""

import time
from dataclasses import dataclass
from threading import Event, Lock, Thread

from schemas.errors import PermanentError, TransientError
from schemas.runtime.process import log_to_stderr
from workers.pool.process import BETWEEN_LEASES, NO_LEASE_YET, LogStyle
from workers.worker.config import WorkerConfig, WorkerObserver
from workers.worker.metrics import WorkerMetrics


@dataclass(frozen=True, slots=True)
class ActorState:
    """State of a worker in its actor.

    Attributes:
        lease_s: Seconds on the current lease; 0 between leases.
        finished: Leases that ended before it did.
        connected: True if it is connected to a router.
        version: Its pipeline version; empty until it is equipped.
        gave_up: Reason for which it will never work here; empty: none.
    """

    lease_s: float = 0.0
    finished: int = 0
    connected: bool = False
    version: str = ""
    gave_up: str = ""


class _Noting(WorkerObserver):
    def __init__(self) -> None:
        self.lock = Lock()
        self.since_s, self.finished = NO_LEASE_YET, 0
        self.is_connected, self.version, self.gave_up = False, "", ""

    def connected(self, connected: bool) -> None:
        self.is_connected = connected

    def equipped(self, pipeline_version: str) -> None:
        self.version = pipeline_version

    def working(self, working: bool) -> None:
        with self.lock:
            self.since_s = time.monotonic() if working else BETWEEN_LEASES
            self.finished += not working


class RayWorker:
    """Worker in an actor; when Ray restarts the actor, the loop starts again.

    No call to an actor mines: the ledger repeats what a dead worker has left, Ray nothing.
    """

    def __init__(self, config: WorkerConfig, style: LogStyle) -> None:
        """Start the loop."""
        self._stop, self._notes = Event(), _Noting()
        log_to_stderr(level=style.level, as_json=style.as_json)
        self._thread = Thread(target=self._run, args=(config,), name="worker", daemon=True)
        self._thread.start()

    def state(self) -> ActorState:
        """Return the state of the worker."""
        notes = self._notes
        with notes.lock:
            lease_s = time.monotonic() - notes.since_s if notes.since_s > 0 else 0.0
            return ActorState(
                lease_s, notes.finished, notes.is_connected, notes.version, notes.gave_up
            )

    def stop(self, within_s: float) -> bool:
        """Ask the worker to finish nearly done work, and wait; return true if it has ended."""
        self._stop.set()
        self._thread.join(within_s)
        return not self._thread.is_alive()

    def _run(self, config: WorkerConfig) -> None:
        from workers.worker.loop import run_worker  # loads numba, in the actor's process alone

        metrics = WorkerMetrics()
        while not self._stop.is_set():
            try:
                run_worker(config, stop=self._stop, observer=self._notes, metrics=metrics)
            except TransientError:
                self._stop.wait(1.0)
            except PermanentError as error:
                self._notes.gave_up = str(error)
                return
