"""A place for one worker in a pool: filled, watched, and filled again after a death."""

import multiprocessing
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from multiprocessing.sharedctypes import Synchronized
from typing import Final

import structlog

from schemas.retry import backoff_s
from workers.pool.process import (
    BETWEEN_LEASES,
    EX_CONFIG,
    EX_DONE,
    NO_LEASE_YET,
    LogStyle,
    worker_process,
)
from workers.worker import WorkerConfig

log = structlog.get_logger(__name__)

FIRST_RESTART_S: Final = 0.5
MOST_RESTART_S: Final = 30.0

MOST_IDLE_DEATHS: Final = 6
"""So many deaths in a row without a lease, over about half a minute, and the place is given up."""

STEADY_S: Final = 60.0
"""A worker that lived this long was not ended by how it starts: its next restart is quick again."""

KILL_MARGIN_S: Final = 10.0
"""After the drain: saying that a lease is given back, closing the session."""


class Slot:
    """One worker process at a time, spawned, since a forked Zenoh session hangs.

    Attributes:
        worker_id: Of every worker that fills this place.
        gave_up: Why nothing will fill it any more; empty while something may.
    """

    def __init__(self, config: WorkerConfig, style: LogStyle, *, deadline_s: float) -> None:
        """Prepare an empty place.

        Args:
            config: For the worker.
            style: For its log.
            deadline_s: A worker longer than this on one lease is killed.
        """
        self.worker_id, self.gave_up = config.worker_id, ""
        self._config, self._style, self._deadline_s = config, style, deadline_s
        self._context = multiprocessing.get_context("spawn")
        self._since_s: Synchronized[float] = self._context.Value("d", NO_LEASE_YET, lock=False)
        self._process: SpawnProcess | None = None
        self._last_words: Connection[str, str] | None = None
        self._started_s = self._restart_at_s = 0.0
        self._waits = _restarts()
        self._idle_deaths = 0

    @property
    def pid(self) -> int | None:
        """Process id of the worker that runs now."""
        process = self._process
        return process.pid if process is not None and process.is_alive() else None

    def is_alive(self) -> bool:
        """Whether a worker runs now."""
        process = self._process
        return process is not None and process.is_alive()

    def look(self) -> bool:
        """Start a worker that is due, kill one that is stuck, bury one that died.

        Returns:
            Whether one was found dead.
        """
        if self._process is None:
            if not self.gave_up and time.monotonic() >= self._restart_at_s:
                self._start()
        elif not self._process.is_alive():
            self._bury(self._process)
            return True
        elif 0 < self._since_s.value < time.monotonic() - self._deadline_s:
            log.error("worker killed: too long on one lease", worker_id=self.worker_id)
            self._process.kill()
            self._since_s.value = BETWEEN_LEASES
        return False

    def tell_to_stop(self) -> None:
        """Ask the worker to finish what is soon done."""
        if self._process is not None:
            self._process.terminate()

    def wait_until_stopped(self) -> None:
        """Wait for its end; kill it if it takes longer than a drain may."""
        if self._process is None:
            return
        self._process.join(self._config.drain_s + KILL_MARGIN_S)
        if self._process.is_alive():
            log.warning("worker killed: it did not stop", worker_id=self.worker_id)
            self._process.kill()
            self._process.join()
        self._process = None

    def _start(self) -> None:
        self._since_s.value = NO_LEASE_YET
        self._last_words, tell = self._context.Pipe(duplex=False)
        self._process = self._context.Process(
            target=worker_process,
            args=(self._config, self._style, self._since_s, tell),
            name=self.worker_id,
        )
        self._process.start()
        tell.close()
        self._started_s = time.monotonic()

    def _bury(self, process: SpawnProcess) -> None:
        code, lived_s = process.exitcode, time.monotonic() - self._started_s
        self._process = None
        if lived_s > STEADY_S or self._since_s.value != NO_LEASE_YET:
            self._waits, self._idle_deaths = _restarts(), 0
        self._idle_deaths += code != EX_DONE
        if code == EX_CONFIG:
            self.gave_up = _said(self._last_words) or "a worker gave up without saying why"
        elif self._idle_deaths >= MOST_IDLE_DEATHS:
            self.gave_up = (
                f"workers die before they get to work, {self._idle_deaths} times in a row, the "
                f"last with exit code {code}; their own words are in the log above"
            )
        wait_s = next(self._waits)
        self._restart_at_s = time.monotonic() + wait_s
        if code != EX_DONE:
            log.warning(
                "worker died",
                worker_id=self.worker_id,
                exit_code=code,
                restart_s=None if self.gave_up else round(wait_s, 1),
            )


def _restarts() -> Iterator[float]:
    return backoff_s(first_s=FIRST_RESTART_S, most_s=MOST_RESTART_S)


def _said(last_words: "Connection[str, str] | None") -> str:
    if last_words is None:
        return ""
    with last_words:
        try:
            return last_words.recv() if last_words.poll() else ""
        except EOFError:
            return ""
