"""Slot: a place for one worker in a pool; starts it, monitors it, and restarts it after a death."""

import multiprocessing
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Final

import structlog

from schemas.runtime.retry import backoff_s
from workers.pool.process import (
    BETWEEN_LEASES,
    EX_CONFIG,
    EX_DONE,
    EX_TEMPFAIL,
    NO_LEASE_YET,
    VERSION_BYTES,
    LogStyle,
    Place,
    Signs,
    worker_process,
)
from workers.worker.config import WorkerConfig
from workers.worker.metrics import Death

log = structlog.get_logger(__name__)

FIRST_RESTART_S: Final = 0.5
MOST_RESTART_S: Final = 60.0

MOST_IDLE_DEATHS: Final = 6
"""Deaths in a row without a lease, over about half a minute, after which a place that never had a
working worker gives up. A place that had one restarts for ever: the present problem will be solved,
and then the pool must not need a restart by hand."""

STEADY_S: Final = 60.0
"""Lifetime after which a death is not blamed on the start, seconds. The next restart is quick
again, unless the worker died in a lease and had finished none."""

DEATHS_WORTH_SAYING: Final = 3
"""Deaths in a row in the first lease after which it is logged: the work is not always the cause."""

KILL_MARGIN_S: Final = 8.0
"""Time after the drain, seconds, to return the lease and close the session. With it, a pool of the
usual drain ends before service managers kill it, after 30 s."""


@contextmanager
def _held_back(number: signal.Signals) -> Iterator[None]:
    """Hold a signal back in this thread, and in a process that it starts, until that one is ready.

    Ctrl-C reaches every process of a terminal; a worker that still imports would print a trace.
    """
    resource_tracker.ensure_running()  # its own start would end the holding back
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {number})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Slot:
    """Runs one worker process at a time, spawned, since a forked Zenoh session hangs.

    Attributes:
        worker_id: Id of every worker in this place.
        place: Place in the pool.
        signs: Shared state of the worker in it.
        gave_up: Reason for no further restarts; empty while there are.
    """

    def __init__(
        self, config: WorkerConfig, style: LogStyle, place: Place, *, deadline_s: float
    ) -> None:
        """Prepare an empty place.

        Args:
            config: Configuration of the worker.
            style: Log style.
            place: Place in the pool.
            deadline_s: A worker longer than this on one lease is killed.
        """
        self.worker_id, self.place, self.gave_up = config.worker_id, place, ""
        self._config, self._style, self._deadline_s = config, style, deadline_s
        self._context = multiprocessing.get_context("spawn")
        self.signs = Signs(
            since_s=self._context.Value("d", NO_LEASE_YET, lock=False),
            finished=self._context.Value("L", 0, lock=False),
            connected=self._context.Value("b", 0, lock=False),
            version=self._context.Array("c", VERSION_BYTES, lock=False),
        )
        self._was_at_work = self._stuck = False
        self._process: SpawnProcess | None = None
        self._last_words: Connection[str, str] | None = None
        self._started_s = self._restart_at_s = 0.0
        self._waits = _restarts()
        self._idle_deaths = self._lease_deaths = 0

    @property
    def pid(self) -> int | None:
        """Process id of the running worker."""
        process = self._process
        return process.pid if process is not None and process.is_alive() else None

    def is_alive(self) -> bool:
        """Test whether a worker runs now."""
        process = self._process
        return process is not None and process.is_alive()

    def look(self) -> Death | None:
        """Start a worker that is due, kill one that is stuck, and clean up after one that died.

        Returns:
            Cause of a death found now; None without one.
        """
        if self._process is None:
            if not self.gave_up and time.monotonic() >= self._restart_at_s:
                self._try_to_start()
        elif not self._process.is_alive():
            return self._bury(self._process)
        elif 0 < self.signs.since_s.value < time.monotonic() - self._deadline_s:
            log.error(
                "worker killed: too long on one lease",
                worker_id=self.worker_id,
                most_s=self._deadline_s,
            )
            self._process.kill()
            self._stuck, self.signs.since_s.value = True, BETWEEN_LEASES
        return None

    def tell_to_stop(self) -> None:
        """Ask the worker to finish work that is nearly done."""
        if self._process is not None:
            self._process.terminate()

    def wait_until_stopped(self, until_s: float) -> None:
        """Wait for its end; kill it at the deadline.

        Args:
            until_s: Deadline, monotonic seconds.
        """
        if self._process is None:
            return
        self._process.join(max(0.0, until_s - time.monotonic()))
        if self._process.is_alive():
            log.warning("worker killed: it did not stop", worker_id=self.worker_id)
            self._process.kill()
            self._process.join()
        self._process = None

    def _try_to_start(self) -> None:
        try:
            self._start()
        except OSError as error:  # no process, memory or file handle is to be had now
            wait_s = next(self._waits)
            self._restart_at_s = time.monotonic() + wait_s
            log.warning(
                "worker cannot be started",
                worker_id=self.worker_id,
                problem=error.strerror or str(error),
                restart_s=round(wait_s, 1),
            )

    def _start(self) -> None:
        self.signs.clear()
        self._stuck = False
        last_words, tell = self._context.Pipe(duplex=False)
        process = self._context.Process(
            target=worker_process,
            args=(self._config, self._style, self.place, self.signs, tell),
            name=self.worker_id,
        )
        try:
            with _held_back(signal.SIGINT):
                process.start()
        except OSError:
            last_words.close()
            raise
        finally:
            tell.close()
        self._process, self._last_words = process, last_words
        self._started_s = time.monotonic()

    def _bury(self, process: SpawnProcess) -> Death:
        code, lived_s = process.exitcode, time.monotonic() - self._started_s
        worked = self.signs.since_s.value != NO_LEASE_YET
        in_lease = self._stuck or self.signs.since_s.value > 0
        has_finished = self.signs.finished.value > 0
        self._process = None
        self.signs.clear()
        self._was_at_work = self._was_at_work or worked
        if has_finished or (lived_s > STEADY_S and not in_lease):
            self._waits, self._lease_deaths = _restarts(), 0
        if lived_s > STEADY_S or worked:
            self._idle_deaths = 0
        self._idle_deaths += code != EX_DONE
        self._lease_deaths += in_lease and code != EX_DONE
        cause = _cause(code, stuck=self._stuck)
        if not self._was_at_work:
            self.gave_up = self._hopeless(code)
        wait_s = next(self._waits)
        self._restart_at_s = time.monotonic() + wait_s
        if self.gave_up:
            cause = "gave_up"
        if code != EX_DONE:
            log.warning(
                "worker died",
                worker_id=self.worker_id,
                cause=cause,
                exit_code=code,
                restart_s=None if self.gave_up else round(wait_s, 1),
            )
        if in_lease and self._lease_deaths == DEATHS_WORTH_SAYING:
            log.error(
                "every worker here dies in its first lease: look at memory and GPU of this "
                "machine; each next one waits longer",
                worker_id=self.worker_id,
                deaths=self._lease_deaths,
                most_wait_s=MOST_RESTART_S,
            )
        return cause

    def _hopeless(self, code: int | None) -> str:
        """Return why no worker will ever start work here; empty while one may."""
        if code == EX_CONFIG:
            return _said(self._last_words) or "a worker gave up without saying why"
        if self._idle_deaths < MOST_IDLE_DEATHS:
            return ""
        return (
            f"workers die before they get to work, {self._idle_deaths} times in a row, the "
            f"last with exit code {code}; their own words are in the log above"
        )


def _cause(code: int | None, *, stuck: bool) -> Death:
    if stuck:
        return "stuck"
    if code == EX_DONE:
        return "stopped"
    return "unready" if code in (EX_TEMPFAIL, EX_CONFIG) else "crashed"


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
