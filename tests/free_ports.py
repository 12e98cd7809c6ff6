"""Ports on which no process listens, different ones for test processes that run side by side."""

import os
import random
import socket
from typing import Final

FIRST: Final = 10_000
SPAN: Final = 2_500
"""Ports of one test process. All lie below those that the kernel gives to clients."""

PROCESSES: Final = 4

_taken: set[int] = set()


def free_port(host: str = "127.0.0.1") -> int:
    """Find a port of this test process that was not handed out before.

    Args:
        host: Address that must be free at this port.
    """
    first = FIRST + SPAN * (_process() % PROCESSES)
    for port in random.sample(range(first, first + SPAN), SPAN):
        if port not in _taken and _is_free(host, port):
            _taken.add(port)
            return port
    raise RuntimeError(f"no port from {first} to {first + SPAN - 1} is free")


def free_endpoint(host: str = "127.0.0.1") -> str:
    """Find an endpoint of this test process that was not handed out before."""
    return f"tcp/{host}:{free_port(host)}"


def _process() -> int:
    """Return the number of this process among those of one test run; 0 if it is alone."""
    return int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))


def _is_free(host: str, port: int) -> bool:
    try:
        socket.create_server((host, port)).close()
    except OSError:
        return False
    return True
