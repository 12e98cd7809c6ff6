"""Worker processes on this machine, kept alive."""

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
from workers.pool.process import LogStyle, Place
from workers.pool.shared_metrics import SharedMetrics
from workers.pool.slot import KILL_MARGIN_S, Slot
from workers.worker.config import DRAIN_S, Accepted, WorkerConfig

log = structlog.get_logger(__name__)

LEASE_DEADLINE_S: Final = 1800.0
"""No honest shard takes this long: twenty seconds of lidar at a hundredth of real time."""

LOOK_S: Final = 0.1
MEND_S: Final = 1.0
"""How often to look for files that somebody took away."""


class LocalPool:
    """Keeps workers alive until it is stopped, or until they say that it is of no use.

    The workers end with this process, however it ends.

    Attributes:
        prefix: What the ids of its workers begin with: leases of a dead pool are found by it. It is
            name, machine and a number of its own; with the place it is an id, which outlives the
            processes in that place, so that the service knows who dies again and again.
        registry: What its workers count, summed up, and the pool's own metrics.
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
    ) -> None:
        """Prepare; `start` starts.

        Args:
            size: Workers to keep alive.
            connect: Endpoints of routers.
            root: First part of every key.
            home: Where the files in which the workers count may lie: a local disk, no place that
                is cleaned while we live, as `/tmp` is.
            name: What the ids of its workers begin with.
            drain_s: How long a worker told to stop may go on with its lease, seconds.
            lease_deadline_s: A worker longer than this on one lease is killed.
            style: How the workers log.
            on_death: Told the id of every worker that died, so that its lease need not expire.
            accepts: Which places a service may name, where a router is on another machine.

        Raises:
            TransientError: If there is no room for the files in which the workers count.
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
        """Start the workers, and watch them."""
        self._watcher.start()

    def alive(self) -> int:
        """Count the workers that run now."""
        return sum(slot.is_alive() for slot in self._slots)

    def pids(self) -> list[int]:
        """Return the process ids of the workers that run now."""
        return [pid for slot in self._slots if (pid := slot.pid) is not None]

    def pipeline_version(self) -> str:
        """Say as what its workers mine; empty until the first of them is equipped."""
        versions = (slot.signs.version.value.decode() for slot in self._slots)
        return next((version for version in versions if version), "")

    def check(self) -> None:
        """Raise why, if nothing will be mined here any more.

        Raises:
            PermanentError: If every worker has given up; with what the first of them said.
            TransientError: If the pool no longer looks after its workers.
        """
        if self._slots and all(slot.gave_up for slot in self._slots):
            raise PermanentError(self._slots[0].gave_up)
        self.check_alive()

    def check_alive(self) -> None:
        """Raise why, if the pool no longer looks after its workers.

        One that was told to stop has not failed, however long its workers take to drain.

        Raises:
            TransientError: In one sentence.
        """
        if self._stopping.is_set() and self._failure is None:
            return
        if not self._watcher.is_alive():
            why = "it is stopped" if self._failure is None else f"{self._failure!r}"
            raise TransientError(f"the pool watches its workers no more: {why}")
        if self._slots and all(slot.gave_up for slot in self._slots):
            raise TransientError(f"every worker has given up: {self._slots[0].gave_up}")

    def check_ready(self) -> None:
        """Raise why, if no worker could take a lease now.

        Raises:
            TransientError: In one sentence.
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
        """Tell the workers to finish what is soon done, and wait; kill those that do not listen."""
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
        """Start."""
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop."""
        self.stop()

    def _watch(self) -> None:
        """Look after the workers; whatever ends this is remembered, for `check_alive` to raise."""
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
    """Name this machine, or container, as a part of a key: it may be known by it in the ledger."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", socket.gethostname())[:64] or "machine"
