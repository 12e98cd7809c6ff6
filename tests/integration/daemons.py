"""Router, service and pool as processes of their own: started, killed, and what they said."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import pytest

from schemas.errors import TransientError
from schemas.transport.keys import DEFAULT_ROOT
from service.client import ControlClient
from service.curation.status import Status
from tests.free_ports import free_endpoint

DEADLINE_S: Final = 300.0
"""For any one thing to happen; generous, since machines that run tests are busy."""

QUICK: Final = {
    "OMP_NUM_THREADS": "1",
    "COUNTERPOINT_LEASE_S": "6",
    "COUNTERPOINT_MAX_ATTEMPTS": "20",
    "COUNTERPOINT_HTTP_LISTEN": "",
    "COUNTERPOINT_WORKER_HTTP_LISTEN": "",
}
"""Settings under which a killed process costs seconds, and none fights for a port."""


def command(*arguments: str) -> list[str]:
    """Return how to run the program as one whom the permissions of files bind, root or not."""
    program = [sys.executable, "-m", "service.cli.main", *arguments]
    if os.geteuid() == 0 and shutil.which("setpriv"):
        return ["setpriv", "--bounding-set=-dac_override,-dac_read_search", *program]
    return program


class Daemon:
    """One process of the system, under a name; killed and started again at will."""

    def __init__(
        self, folder: Path, name: str, *arguments: str, env: Mapping[str, str] | None = None
    ) -> None:
        self.name = name
        self._arguments, self._env = arguments, dict(env or {})
        self._log = folder / f"{name}.log"
        self._process: subprocess.Popen[bytes] | None = None
        self.started_s = 0.0

    def start(self) -> None:
        self.started_s = time.monotonic()
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                command(*self._arguments),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=os.environ | QUICK | self._env,
            )

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def is_running(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def ended(self) -> int | None:
        """With what it ended by itself; None while it runs."""
        return None if self._process is None else self._process.poll()

    def kill(self) -> None:
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def restart(self) -> None:
        self.kill()
        self.start()

    def stop(self) -> int:
        assert self._process is not None
        self._process.terminate()
        return self._process.wait(timeout=60)

    def end(self) -> None:
        if self.is_running():
            self.kill()

    def said(self) -> str:
        return self._log.read_text(errors="replace") if self._log.exists() else ""

    def words(self) -> str:
        return f"--- {self.name}\n" + "\n".join(self.said().splitlines()[-40:])


class System:
    """Router, service and a pool of two workers over one bucket, and what the service says."""

    def __init__(
        self, folder: Path, bucket: str, *options: str, env: Mapping[str, str] | None = None
    ) -> None:
        """Prepare; `start` starts.

        Args:
            folder: For state and logs of the processes.
            bucket: URL of the log bucket.
            options: More of `counterpoint service`.
            env: More variables, for all three.
        """
        self.endpoint, self.state = free_endpoint(), folder / "state"
        at = ("--connect", self.endpoint)
        serve = ("service", "--bucket", bucket, "--state", str(self.state), *at, *options)
        self.router = Daemon(folder, "router", "router", "--listen", self.endpoint, env=env)
        self.service = Daemon(folder, "service", *serve, env=env)
        self.pool = Daemon(folder, "pool", "worker", "--workers", "2", *at, env=env)
        self.daemons = (self.router, self.service, self.pool)
        self.client = ControlClient([self.endpoint], root=DEFAULT_ROOT)

    def start(self) -> None:
        for daemon in self.daemons:
            daemon.start()

    def end(self) -> None:
        for daemon in self.daemons:
            daemon.end()

    def stop(self) -> list[int]:
        return [daemon.stop() for daemon in (self.pool, self.service, self.router)]

    def status(self) -> Status | None:
        """How far everything is; None while nobody answers."""
        try:
            return self.client.status()
        except TransientError:
            return None

    def states(self) -> dict[str, str]:
        """Log id to state; empty while nobody answers."""
        status = self.status()
        return {log.log_id: log.state for log in status.logs} if status is not None else {}

    def done(self) -> int:
        """Shards done; -1 while nobody answers."""
        status = self.status()
        return status.shards_by_state.get("done", 0) if status is not None else -1

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Wait for something to happen.

        Raises:
            pytest.fail.Exception: If it does not in time; with the last words of every process.
        """
        end_s = time.monotonic() + DEADLINE_S
        while not condition():
            if time.monotonic() > end_s:
                words = "\n".join(daemon.words() for daemon in self.daemons)
                pytest.fail(f"not within {DEADLINE_S:g} s: {what}\n{self.status()}\n{words}")
            time.sleep(0.05)

    def kill_worker(self) -> None:
        """Kill one worker of the pool: the pool must start another."""
        self.until(lambda: bool(workers_of(self.pool.pid)), "a worker")
        os.kill(workers_of(self.pool.pid)[0], signal.SIGKILL)

    def restart(self, *daemons: Daemon) -> None:
        for daemon in daemons:
            daemon.kill()
        for daemon in daemons:
            daemon.start()


def workers_of(pool: int) -> list[int]:
    """Children of the pool that run a worker, from the kernel's list; none when it has ended."""
    try:
        threads = list(Path(f"/proc/{pool}/task").iterdir())
    except OSError:
        return []
    children = [child for at in threads for child in _read(at / "children").split()]
    return sorted(
        int(pid) for pid in children if "spawn_main" in _read(Path(f"/proc/{pid}/cmdline"))
    )


def _read(path: Path) -> str:
    """Read a file of a thread or process; empty when that has just ended."""
    try:
        return path.read_text()
    except OSError:
        return ""
