"""Local pool: worker processes on this machine, restarted when they die."""

import re
import socket
import time
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Event, Thread
from types import TracebackType
from typing import Final, Self

import structlog
from prometheus_client import CollectorRegistry

from schemas.errors import PermanentError, TransientError
from schemas.transport.locks import OPEN, Locks
from workers.pool.process import LogStyle, Place
from workers.pool.shared_metrics import SharedMetrics
from workers.pool.slot import KILL_MARGIN_S, Slot
from workers.worker.config import DRAIN_S, Accepted, WorkerConfig

log = structlog.get_logger(__name__)

LEASE_DEADLINE_S: Final = 1800.0
"""Longest time on one lease, seconds: twenty seconds of lidar at a hundredth of real time."""

LOOK_S: Final = 0.1
MEND_S: Final = 1.0
"""Interval of the check for removed files, seconds."""


class LocalPool:
    """Keeps workers alive until it is stopped, or until they all give up.

    The workers end with this process, even if it is killed.

    Attributes:
        prefix: Prefix of the ids of its workers, by which leases of a dead pool are found. It is
            name, machine and a unique number. With the place it is an id, which outlives the
            processes in that place, so that the service can recognise repeated deaths.
        registry: Metrics of its workers, summed up, and the pool's own.
    """

    def __init__(
        self,
        size: int,
        *,
        connect: Sequence[str],
        root: str,
        home: Path,
        name: str = "local",
        drain_s: float = DRAIN_S,
        lease_deadline_s: float = LEASE_DEADLINE_S,
        style: LogStyle | None = None,
        on_death: Callable[[str], None] = lambda _: None,
        accepts: Accepted | None = None,
        locks: Locks = OPEN,
    ) -> None:
        """Prepare the pool; `start` starts the workers.

        Args:
            size: Workers to keep alive.
            connect: Endpoints of routers.
            root: First part of every key.
            home: Folder for the metrics files of the workers: a local disk that no cleaner empties
                while the pool runs, unlike `/tmp`.
            name: First part of the ids of its workers.
            drain_s: Time a stopping worker may continue with its lease, seconds.
            lease_deadline_s: A worker longer than this on one lease is killed.
            style: Log style of the workers.
            on_death: Called with the id of every worker that died, so that its lease need not
                expire.
            accepts: Locations that a service may name, where a router is on another machine.
            locks: Certificates of the workers' sessions.

        Raises:
            TransientError: If there is no room for the metrics files.
        """
        self.prefix = f"{name}-{_machine()}-{uuid.uuid4().hex[:12]}-"
        self._on_death, self._drain_s = on_death, drain_s
        self._metrics = SharedMetrics(home, places=size)
        self.registry: CollectorRegistry = self._metrics.registry
        self._slots = [
            Slot(
                WorkerConfig(
                    f"{self.prefix}{number}",
                    tuple(connect),
                    root,
                    drain_s,
                    accepts or Accepted(),
                    locks,
                ),
                style or LogStyle(),
                Place(number, self._metrics.folder),
                deadline_s=lease_deadline_s,
            )
            for number in range(size)
        ]
        self._metrics.pool.wanted.set(size)
        self._metrics.pool.alive.set_function(self.alive)
        self._stopping = Event()
        self._failure: Exception | None = None
        self._watcher = Thread(target=self._watch, name="pool", daemon=True)

    def start(self) -> None:
        """Start the workers, and monitor them."""
        self._watcher.start()

    def alive(self) -> int:
        """Count the workers that run now."""
        return sum(slot.is_alive() for slot in self._slots)

    def pids(self) -> list[int]:
        """Return the process ids of the workers that run now."""
        return [pid for slot in self._slots if (pid := slot.pid) is not None]

    def pipeline_version(self) -> str:
        """Return the pipeline version of its workers; empty until the first of them is equipped."""
        versions = (slot.signs.version.value.decode() for slot in self._slots)
        return next((version for version in versions if version), "")

    def check(self) -> None:
        """Raise the reason if nothing will be mined here any more.

        Raises:
            PermanentError: If every worker has given up; with the message of the first one.
            TransientError: If the pool no longer monitors its workers.
        """
        if self._slots and all(slot.gave_up for slot in self._slots):
            raise PermanentError(self._slots[0].gave_up)
        self.check_alive()

    def check_alive(self) -> None:
        """Raise the reason if the pool no longer monitors its workers.

        A stopped pool has not failed, however long its workers take to drain.

        Raises:
            TransientError: With the reason in one sentence.
        """
        if self._stopping.is_set() and self._failure is None:
            return
        if not self._watcher.is_alive():
            why = "it is stopped" if self._failure is None else f"{self._failure!r}"
            raise TransientError(f"the pool watches its workers no more: {why}")
        if self._slots and all(slot.gave_up for slot in self._slots):
            raise TransientError(f"every worker has given up: {self._slots[0].gave_up}")

    def check_ready(self) -> None:
        """Raise the reason if no worker could take a lease now.

        Raises:
            TransientError: With the reason in one sentence.
        """
        self.check_alive()
        signs = [slot.signs for slot in self._slots if slot.is_alive()]
        if not any(each.connected.value for each in signs):
            raise TransientError("no worker is connected to a router")
        if not any(each.connected.value and each.version.value for each in signs):
            raise TransientError(
                "no worker is equipped: no service has said what to mine, or what it says is not "
                "accepted here (the log says why)"
            )

    def stop(self) -> None:
        """Ask the workers to finish nearly done work, and wait; kill those that do not stop."""
        self._stopping.set()
        if self._watcher.ident is not None:
            self._watcher.join()
        until_s = time.monotonic() + self._drain_s + KILL_MARGIN_S
        for slot in self._slots:
            slot.tell_to_stop()
        for slot in self._slots:
            slot.wait_until_stopped(until_s)
        self._metrics.remove()

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

    def _watch(self) -> None:
        """Monitor the workers; an exception is stored for `check_alive` to raise."""
        mend_at_s = time.monotonic() + MEND_S
        try:
            while not self._stopping.wait(LOOK_S):
                if time.monotonic() >= mend_at_s:
                    self._metrics.mend()
                    mend_at_s = time.monotonic() + MEND_S
                self._look()
        except Exception as error:
            self._failure = error
            raise

    def _look(self) -> None:
        for slot in self._slots:
            cause = slot.look()
            if cause is not None:
                self._metrics.forget_gauges(slot.place.number)
                self._metrics.pool.died(cause)
                self._tell(slot.worker_id)

    def _tell(self, worker_id: str) -> None:
        try:
            self._on_death(worker_id)
        except TransientError as error:  # its lease will expire instead
            log.warning("death not told", worker_id=worker_id, problem=str(error))


def _machine() -> str:
    """Return the name of this machine, or container, as a part of a key in the ledger."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", socket.gethostname())[:64] or "machine"
