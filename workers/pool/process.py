"""One worker process: what the pool tells it, what it tells the pool, and how it ends."""

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
"""Ends that are no crash: told to stop; may work later; will never work here (sysexits.h)."""


@dataclass(frozen=True, slots=True)
class LogStyle:
    """How a worker process logs; a spawned process inherits nothing."""

    level: str = "info"
    as_json: bool = False


_REMOVALS: Final = 5
"""Another thread, or another worker, may just be making a file in what is taken away."""

VERSION_BYTES: Final = 64
"""Room for a pipeline version, and an end."""

NO_LEASE_YET: Final = 0.0
BETWEEN_LEASES: Final = -1.0
"""What stands where the time is told when work on the current lease began."""


@dataclass(frozen=True, slots=True)
class Signs:
    """What a worker shows its pool, in memory that both share.

    Attributes:
        since_s: When work on the current lease began, monotonic seconds, or one of `NO_LEASE_YET`
            and `BETWEEN_LEASES`.
        finished: Leases that ended before it did.
        connected: Whether it has a router.
        version: As what it mines what the service asks for; empty until it can.
    """

    since_s: "Synchronized[float]"
    finished: "Synchronized[int]"
    connected: "Synchronized[int]"
    version: "SynchronizedString"

    def clear(self) -> None:
        """Nothing is known of the worker that comes next."""
        self.since_s.value, self.finished.value = NO_LEASE_YET, 0
        self.connected.value, self.version.value = 0, b""


@dataclass(frozen=True, slots=True)
class Place:
    """Where in its pool a worker is.

    Attributes:
        number: Unique in the pool.
        metrics_folder: Where the workers of the pool count.
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
    """Run a worker in a process of its own.

    Args:
        config: For the worker.
        style: For its log.
        place: Where in the pool it is.
        signs: What it shows of itself.
        problem: Takes why it gives up for good.
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
    """Turn signals into a set event, however many come.

    A service manager may signal every process of ours, and then the pool tells its workers once
    more: that must not cut the drain short. The pool kills those that take too long, and all die
    with it.
    """
    stop = Event()

    def on_signal(_number: int, _frame: FrameType | None) -> None:
        stop.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, on_signal)
    return stop


def _leave(code: int) -> NoReturn:
    """End at once: everything is closed, and taking torch and numba apart takes seconds."""
    sys.stderr.flush()
    os._exit(code)


def _end_with_parent(place: Place) -> None:
    """Die when the pool's process dies, even of kill -9: nobody would stop or restart us.

    Nobody would take its files away either.
    """
    parent = parent_process()
    if parent is not None:
        parent.join()
        for _ in range(_REMOVALS):
            shutil.rmtree(place.metrics_folder, ignore_errors=True)
            if not place.metrics_folder.exists():
                break
        os._exit(EX_TEMPFAIL)
