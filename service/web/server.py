"""Server of the page: its address, and its life until it is stopped."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Final

import uvicorn
from fastapi import FastAPI

from schemas.errors import TransientError
from service.errors import UsageError

MOST_CONNECTIONS: Final = 200
"""Open requests at a time; a browser holds one for live scenes, and six more at most."""

_START_S: Final = 10.0
_STOP_S: Final = 2
"""Time for open requests when the page stops, seconds."""


def address_of(listen: str) -> tuple[str, int]:
    """Return host and port of an address.

    Raises:
        UsageError: If it is none.
    """
    host, colon, port = listen.rpartition(":")
    if not (colon and host and port.isascii() and port.isdecimal() and int(port) <= 65_535):
        raise UsageError(
            f"not an address for the review page: {listen!r}; it is HOST:PORT, such as "
            "127.0.0.1:8087, and port 0 takes a free one"
        )
    return host.removeprefix("[").removesuffix("]"), int(port)


def listening(listen: str) -> socket.socket:
    """Open the socket of an address.

    Raises:
        UsageError: If it is no address.
        TransientError: If it is taken, or of another machine.
    """
    host, port = address_of(listen)
    try:
        family, kind, _, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with ExitStack() as opened:
            made = opened.enter_context(socket.socket(family, kind))
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            made.bind(where)
            made.listen()
            opened.pop_all()
    except OSError as error:
        raise TransientError(
            f"cannot serve the review page on {listen}: {error.strerror or error}; name another "
            "address with --listen, or port 0 for a free one"
        ) from error
    return made


def url_of(opened: socket.socket, *, scheme: str = "http") -> str:
    """Return the URL of a socket; one that listens everywhere is named by the loopback."""
    host, port = opened.getsockname()[:2]
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)  # noqa: S104
    return f"{scheme}://{_joined(host, port)}/"


def address_in(opened: socket.socket) -> str:
    """Return the address that a socket listens on, HOST:PORT."""
    return _joined(*opened.getsockname()[:2])


def _joined(host: str, port: int) -> str:
    return f"{f'[{host}]' if ':' in host else host}:{port}"


@contextmanager
def serving(
    app: FastAPI,
    opened: socket.socket,
    *,
    on_stop: Callable[[], None],
    certificate: str = "",
    key: str = "",
) -> Iterator[threading.Thread]:
    """Serve a page within a `with` block; the thread that serves ends early only if it fails.

    Args:
        app: The application.
        opened: Its socket; it is closed at the end.
        on_stop: Called before the server waits for open requests, to end those that are endless.
        certificate: File of the certificate and its chain; empty: plain HTTP.
        key: File of its private key.

    Raises:
        TransientError: If the server does not start.
    """
    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        ws="none",
        limit_concurrency=MOST_CONNECTIONS,
        timeout_graceful_shutdown=_STOP_S,
        ssl_certfile=certificate or None,
        ssl_keyfile=key or None,
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(
        target=server.run, kwargs={"sockets": [opened]}, name="page", daemon=True
    )
    thread.start()
    try:
        _wait_for_start(server, thread)
        yield thread
    finally:
        on_stop()
        server.should_exit = True
        thread.join(2 * _STOP_S)
        opened.close()


def _wait_for_start(server: uvicorn.Server, thread: threading.Thread) -> None:
    waiting = threading.Event()
    for _ in range(round(_START_S / 0.02)):
        if server.started:
            return
        if not thread.is_alive():
            break
        waiting.wait(0.02)
    raise TransientError("the server of the review page did not start")
