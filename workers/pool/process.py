"""Worker process: its state in shared memory, its signals, and its exit codes."""

import os
import shutil
import signal
import sys
import time
from dataclasses import dataclass
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from multiprocessing.sharedctypes import Synchronized, SynchronizedString
from pathlib import Path
from threading import Event, Thread
from types import FrameType
from typing import Final, NoReturn

import structlog

from schemas.errors import PermanentError, TransientError
from schemas.runtime.process import log_to_stderr
from workers.pool.shared_metrics import count_in
from workers.worker.config import WorkerConfig, WorkerObserver
from workers.worker.metrics import WorkerMetrics

log = structlog.get_logger(__name__)

EX_DONE: Final = 0
EX_TEMPFAIL: Final = 75
EX_CONFIG: Final = 78
"""Exit codes that are no crash: stopped on request; may work later; will never work here
(sysexits.h)."""


@dataclass(frozen=True, slots=True)
class LogStyle:
    """Log style of a worker process; a spawned process inherits nothing."""

    level: str = "info"
    as_json: bool = False


_REMOVALS: Final = 5
"""Attempts to remove a folder, in which another thread or worker may be creating a file."""

VERSION_BYTES: Final = 64
"""Bytes for a pipeline version and a terminator."""

NO_LEASE_YET: Final = 0.0
BETWEEN_LEASES: Final = -1.0
"""Values of `Signs.since_s` without a current lease."""


@dataclass(frozen=True, slots=True)
class Signs:
    """State of a worker in memory that it shares with its pool.

    Attributes:
        since_s: When work on the current lease began, monotonic seconds, or one of `NO_LEASE_YET`
            and `BETWEEN_LEASES`.
        finished: Leases that ended before it did.
        connected: Whether it is connected to a router.
        version: Its pipeline version; empty until it is equipped.
    """

    since_s: "Synchronized[float]"
    finished: "Synchronized[int]"
    connected: "Synchronized[int]"
    version: "SynchronizedString"

    def clear(self) -> None:
        """Reset the state for the next worker."""
        self.since_s.value, self.finished.value = NO_LEASE_YET, 0
        self.connected.value, self.version.value = 0, b""


@dataclass(frozen=True, slots=True)
class Place:
    """Place of a worker in its pool.

    Attributes:
        number: Number of the place, unique in the pool.
        metrics_folder: Folder of the pool's metrics files.
    """

    number: int
    metrics_folder: Path


class _Showing(WorkerObserver):
    def __init__(self, signs: Signs) -> None:
        self._signs = signs

    def connected(self, connected: bool) -> None:
        self._signs.connected.value = connected

    def equipped(self, pipeline_version: str) -> None:
        self._signs.version.value = pipeline_version.encode()

    def working(self, working: bool) -> None:
        self._signs.since_s.value = time.monotonic() if working else BETWEEN_LEASES
        self._signs.finished.value += not working


def worker_process(
    config: WorkerConfig,
    style: LogStyle,
    place: Place,
    signs: Signs,
    problem: "Connection[str, str]",
) -> None:
    """Run a worker in its own process.

    Args:
        config: Configuration of the worker.
        style: Log style.
        place: Its place in the pool.
        signs: Its shared state.
        problem: Receives the reason when it gives up for good.
    """
    from workers.worker.loop import run_worker  # the pool, which never mines, does without numba

    stop = _stop_on_signals()
    log_to_stderr(level=style.level, as_json=style.as_json)
    Thread(target=_end_with_parent, args=(place,), name="parent", daemon=True).start()
    count_in(place.metrics_folder, place.number)
    metrics = WorkerMetrics()
    try:
        run_worker(config, stop=stop, observer=_Showing(signs), metrics=metrics)
    except TransientError as error:
        if stop.is_set():
            _leave(EX_DONE)
        log.warning("worker ends", worker_id=config.worker_id, problem=str(error))
        _leave(EX_TEMPFAIL)
    except PermanentError as error:
        log.error("worker gives up", worker_id=config.worker_id, problem=str(error))
        problem.send(str(error))
        _leave(EX_CONFIG)
    _leave(EX_DONE)


def _stop_on_signals() -> Event:
    """Turn any number of signals into a set event.

    A service manager may signal all processes, and then the pool signals its workers again. That
    must not cut the drain short. The pool kills workers that take too long, and all die with it.
    """
    stop = Event()

    def on_signal(_number: int, _frame: FrameType | None) -> None:
        stop.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, on_signal)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # the pool held it back
    return stop


def _leave(code: int) -> NoReturn:
    """Exit at once: everything is closed, and teardown of torch and numba takes seconds."""
    sys.stderr.flush()
    os._exit(code)


def _end_with_parent(place: Place) -> None:
    """Exit when the pool's process dies, even of kill -9: no process would restart the worker.

    The worker also removes the pool's files, which would remain otherwise.
    """
    parent = parent_process()
    if parent is not None:
        parent.join()
        for _ in range(_REMOVALS):
            shutil.rmtree(place.metrics_folder, ignore_errors=True)
            if not place.metrics_folder.exists():
                break
        os._exit(EX_TEMPFAIL)
