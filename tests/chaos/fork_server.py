"""A process that has loaded the program, and forks one that runs it: a start costs little.

Chaos kills hundreds of processes. Loading the program again for each would take most of the time.
The server opens no bus and starts no thread; each child is a process of its own, which a signal
ends as any other.
"""

import ctypes
import json
import os
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

from tests.integration.standby_pair import Process
from tests.integration.steered_clock import follow_own_clock

LOADED: Final = (
    "service.alone",
    "service.router",
    "service.cli.daemons",
    "service.cli.main",
    "tests.integration.quick_miner",
)
"""Modules that every child needs."""

_DIE_WITH_PARENT: Final = 1
"""Option of prctl(2): the signal that a child gets when its parent ends."""


class ForkServer:
    """The side of the harness: starts processes through the server, within a `with` block."""

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        """Prepare.

        Args:
            environment: Variables of the server itself, such as a library that it loads first.
        """
        self._environment = {"OMP_NUM_THREADS": "1"} | dict(environment or {})

    def __enter__(self) -> Self:
        self._server = subprocess.Popen(
            [sys.executable, "-m", "tests.chaos.fork_server"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | self._environment,
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._server.communicate()  # closes its stdin, which ends it

    def spawn(self, command: list[str], environment: dict[str, str], log: Path) -> Process:
        """Start a module with its arguments; see `tests.integration.standby_pair.Spawn`."""
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        asked = {"command": command, "environment": environment, "log": str(log)}
        self._server.stdin.write(json.dumps(asked) + "\n")
        self._server.stdin.flush()
        return Forked(int(self._server.stdout.readline()))


class Forked:
    """A process that the server forked, and reaps by itself."""

    def __init__(self, pid: int) -> None:
        """Keep its id."""
        self.pid = pid

    def send_signal(self, sig: int) -> None:
        """Send a signal to it, if it runs."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, sig)

    def poll(self) -> int | None:
        """Return 0 once it has ended; None while it runs."""
        return None if Path(f"/proc/{self.pid}").exists() else 0

    def wait(self) -> int:
        """Wait for its end."""
        while self.poll() is None:
            time.sleep(0.002)
        return 0


def main() -> None:
    """Fork a child for each line on stdin, and print its id, until stdin ends."""
    for module in LOADED:
        __import__(module)
    threads = len(list(Path("/proc/self/task").iterdir()))
    assert threads == 1, f"a fork would lose {threads - 1} threads"
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the kernel reaps them
    for line in sys.stdin:
        pid = os.fork()
        if pid == 0:
            _run(**json.loads(line))
        sys.stdout.write(f"{pid}\n")
        sys.stdout.flush()


def _run(command: list[str], environment: dict[str, str], log: str) -> None:
    """Become a process of the system; never return."""
    code = 1
    try:
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        written = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        nothing = os.open(os.devnull, os.O_RDONLY)
        for opened, standard in ((nothing, 0), (written, 1), (written, 2)):
            os.dup2(opened, standard)
        os.environ.update(environment)
        follow_own_clock()
        sys.argv = command
        sys.modules.pop(command[0], None)
        runpy.run_module(command[0], run_name="__main__", alter_sys=True)
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    except BaseException:  # noqa: BLE001
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    main()
