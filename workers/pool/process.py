"""One worker process: what the pool tells it, what it tells the pool, and how it ends."""

import os
import sys
import time
from dataclasses import dataclass
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from multiprocessing.sharedctypes import Synchronized
from threading import Thread
from typing import Final, NoReturn

import structlog

from schemas.errors import PermanentError, TransientError
from schemas.process import log_to_stderr, stop_on_signals
from workers.worker import WorkerConfig, run_worker

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


NO_LEASE_YET: Final = 0.0
BETWEEN_LEASES: Final = -1.0
"""What stands where the time is told when work on the current lease began."""


def worker_process(
    config: WorkerConfig,
    style: LogStyle,
    since_s: "Synchronized[float]",
    problem: "Connection[str, str]",
) -> None:
    """Run a worker in a process of its own.

    Args:
        config: For the worker.
        style: For its log.
        since_s: Shared: when work on the current lease began, monotonic seconds, or one of
            `NO_LEASE_YET` and `BETWEEN_LEASES`.
        problem: Takes why it gives up for good.
    """
    log_to_stderr(level=style.level, as_json=style.as_json)
    Thread(target=_end_with_parent, name="parent", daemon=True).start()

    def on_lease(working: bool) -> None:
        since_s.value = time.monotonic() if working else BETWEEN_LEASES

    with stop_on_signals() as stop:
        try:
            run_worker(config, stop=stop, on_lease=on_lease)
        except TransientError as error:
            log.warning("worker ends", worker_id=config.worker_id, problem=str(error))
            _leave(EX_DONE if stop.is_set() else EX_TEMPFAIL)
        except PermanentError as error:
            log.error("worker gives up", worker_id=config.worker_id, problem=str(error))
            problem.send(str(error))
            _leave(EX_CONFIG)
    _leave(EX_DONE)


def _leave(code: int) -> NoReturn:
    """End at once: everything is closed, and taking torch and numba apart takes seconds."""
    sys.stderr.flush()
    os._exit(code)


def _end_with_parent() -> None:
    """Die when the pool's process dies, even of kill -9: nobody would stop or restart us."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(EX_TEMPFAIL)
