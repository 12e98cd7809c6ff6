"""Ctrl-C reaches every process of a terminal: a worker that still starts must not die of it."""

import signal
import subprocess
import sys

from workers.pool.slot import _held_back


def _blocked() -> set[int]:
    return set(signal.pthread_sigmask(signal.SIG_BLOCK, ()))


def test_a_process_that_is_started_holds_ctrl_c_back_until_it_is_ready() -> None:
    before = _blocked()
    script = "import signal; print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ()))"
    with _held_back(signal.SIGINT):
        ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
        assert signal.SIGINT in _blocked()
    assert ran.stdout == "True\n"
    assert _blocked() == before
