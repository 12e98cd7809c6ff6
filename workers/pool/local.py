"""Worker processes on this machine, kept alive."""

import uuid
from collections.abc import Callable, Sequence
from threading import Event, Thread
from types import TracebackType
from typing import Final, Self

import structlog

from schemas.errors import PermanentError, TransientError
from workers.pool.process import LogStyle
from workers.pool.slot import Slot
from workers.worker import DRAIN_S, WorkerConfig

log = structlog.get_logger(__name__)

LEASE_DEADLINE_S: Final = 1800.0
"""No honest shard takes this long: twenty seconds of lidar at a hundredth of real time."""

LOOK_S: Final = 0.1


class LocalPool:
    """Keeps workers alive until it is stopped, or until they say that it is of no use.

    The workers end with this process, however it ends.

    Attributes:
        prefix: What the ids of its workers begin with: leases of a dead pool are found by it.
    """

    def __init__(
        self,
        size: int,
        *,
        connect: Sequence[str],
        root: str,
        name: str = "local",
        drain_s: float = DRAIN_S,
        lease_deadline_s: float = LEASE_DEADLINE_S,
        style: LogStyle | None = None,
        on_death: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Prepare; `start` starts.

        Args:
            size: Workers to keep alive.
            connect: Endpoints of routers.
            root: First part of every key.
            name: What the ids of its workers begin with.
            drain_s: How long a worker told to stop may go on with its lease, seconds.
            lease_deadline_s: A worker longer than this on one lease is killed.
            style: How the workers log.
            on_death: Told the id of every worker that died, so that its lease need not expire.
        """
        self.prefix = f"{name}-{uuid.uuid4().hex[:12]}-"
        self._on_death = on_death
        self._slots = [
            Slot(
                WorkerConfig(f"{self.prefix}{number}", tuple(connect), root, drain_s),
                style or LogStyle(),
                deadline_s=lease_deadline_s,
            )
            for number in range(size)
        ]
        self._stopping = Event()
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

    def check(self) -> None:
        """Raise why, if every worker has given up: then nothing will ever be mined here.

        Raises:
            PermanentError: With what the first of them said.
        """
        if self._slots and all(slot.gave_up for slot in self._slots):
            raise PermanentError(self._slots[0].gave_up)

    def stop(self) -> None:
        """Tell the workers to finish what is soon done, and wait; kill those that do not listen."""
        self._stopping.set()
        self._watcher.join()
        for slot in self._slots:
            slot.tell_to_stop()
        for slot in self._slots:
            slot.wait_until_stopped()

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
        while not self._stopping.wait(LOOK_S):
            for slot in self._slots:
                if slot.look():
                    self._tell(slot.worker_id)

    def _tell(self, worker_id: str) -> None:
        try:
            self._on_death(worker_id)
        except TransientError as error:  # its lease will expire instead
            log.warning("death not told", worker_id=worker_id, problem=str(error))
