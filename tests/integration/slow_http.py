"""Clients that keep an HTTP endpoint busy with requests that never end."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from http.client import HTTPConnection, HTTPException
from typing import Final

CLIENTS: Final = 40
DRIP_S: Final = 0.5
ANSWER_S: Final = 30.0
"""Within this somebody who asks as one should must be answered, although they go on."""

_BEGIN: Final = b"GET /status HTTP/1.1\r\nHost: x\r\nX-Never-Ends: "


def hold_up(address: str, seconds: float) -> int:
    """Let many clients send a byte now and then, and ask meanwhile; return how often it was vain.

    Args:
        address: `host:port` of the endpoint.
        seconds: How long they go on at least.

    Raises:
        AssertionError: If an honest request is not answered in time.
    """
    with _slow_clients(address):
        vain = _until_answered(address)
        time.sleep(seconds)
        return vain + _until_answered(address)


def _until_answered(address: str) -> int:
    end_s, vain = time.monotonic() + ANSWER_S, 0
    while time.monotonic() < end_s:
        if _is_answered(address):
            return vain
        vain += 1
        time.sleep(0.2)
    raise AssertionError(f"{address} answers nobody for {ANSWER_S:g} s: slow clients hold it up")


def _is_answered(address: str) -> bool:
    connection = HTTPConnection(address, timeout=5)
    try:
        connection.request("GET", "/healthz")
        with connection.getresponse() as reply:
            return reply.status == 200
    except (OSError, HTTPException):
        return False
    finally:
        connection.close()


@contextmanager
def _slow_clients(address: str) -> Iterator[None]:
    over = threading.Event()
    threads = [threading.Thread(target=_drip, args=(address, over)) for _ in range(CLIENTS)]
    with ExitStack() as ending:
        for thread in threads:
            ending.callback(thread.join)
        ending.callback(over.set)
        for thread in threads:
            thread.start()
        yield


def _drip(address: str, over: threading.Event) -> None:
    """Send one request, byte by byte, and another when that is broken off."""
    host, _, port = address.rpartition(":")
    while not over.is_set():
        try:
            with socket.create_connection((host, int(port)), timeout=5) as connection:
                connection.sendall(_BEGIN)
                while not over.wait(DRIP_S):
                    connection.sendall(b"x")
        except OSError:
            over.wait(DRIP_S)
