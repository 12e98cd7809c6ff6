"""Stands before a real store and lets some requests go wrong, in an order that a seed decides."""

import socket
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from http.client import HTTPConnection, HTTPException, HTTPResponse
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Final, Literal, Self
from urllib.parse import unquote, urlsplit

import numpy as np

Fault = Literal["500", "503", "reset", "truncated", "delayed"]

_DELAY_S: Final = 0.5
_HOP: Final = frozenset({"connection", "transfer-encoding", "content-length"})
_BODY: Final = (
    b"<?xml version='1.0' encoding='UTF-8'?><Error><Code>%s</Code>"
    b"<Message>Please reduce your request rate.</Message></Error>"
)


class FaultyProxy:
    """A proxy for one store, on a port of its own, for as long as the `with` block lasts.

    Attributes:
        endpoint: Its URL.
        requests: How many have come.
        faults: What was done to how many of them.
    """

    def __init__(self, upstream: str, *, seed: int = 1) -> None:
        """Prepare; nothing goes wrong before it is asked for.

        Args:
            upstream: URL of the store.
            seed: Of what goes wrong by chance.
        """
        self.requests, self.faults = 0, Counter[str]()
        self._upstream = urlsplit(upstream)
        self._shares: dict[Fault, float] = {}
        self._random = np.random.default_rng(seed)
        self._lock = threading.Lock()
        self._in_mid_body: dict[str, Callable[[], None]] = {}
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        self._server.daemon_threads = True
        self.endpoint = f"http://127.0.0.1:{self._server.server_port}"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,))

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def let_fail(self, shares: Mapping[Fault, float]) -> None:
        """Let these shares of all requests meet these faults until `calm`."""
        with self._lock:
            self._shares = dict(shares)

    def storm(self) -> None:
        """Answer everything with 503 until `calm`."""
        self.let_fail({"503": 1.0})

    def calm(self) -> None:
        """Let nothing fail any more."""
        self.let_fail({})

    def in_next_body(self, key: str, happens: Callable[[], None]) -> None:
        """Call this once, when half of the next read of an object is sent, and break off there."""
        with self._lock:
            self._in_mid_body[key] = happens

    def _draw(self) -> Fault | None:
        with self._lock:
            self.requests += 1
            chosen = self._by_chance()
            if chosen is not None:
                self.faults[chosen] += 1
        return chosen

    def _by_chance(self) -> Fault | None:
        drawn = self._random.random()
        for fault, share in self._shares.items():
            if drawn < share:
                return fault
            drawn -= share
        return None

    def _take_happening(self, path: str) -> Callable[[], None] | None:
        key = unquote(urlsplit(path).path).split("/", 2)[-1]
        with self._lock:
            return self._in_mid_body.pop(key, None)

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        proxy = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def __getattr__(self, name: str) -> Callable[[], None]:
                if name.startswith("do_"):  # every method alike
                    return self._meet
                raise AttributeError(name)

            def _meet(self) -> None:
                body = self.rfile.read(int(self.headers.get("Content-Length", "0")))
                fault = proxy._draw()
                if fault == "reset":
                    self._reset()
                elif fault in ("500", "503"):
                    code = b"SlowDown" if fault == "503" else b"InternalError"
                    self._answer(int(fault), {}, _BODY % code)
                else:
                    if fault == "delayed":
                        time.sleep(_DELAY_S)
                    self._forward(body, truncated=fault == "truncated")

            def log_request(self, code: object = "-", size: object = "-") -> None:
                """Keep the test's output clean."""

            def _forward(self, body: bytes, *, truncated: bool) -> None:
                try:
                    reply, data = self._ask(body)
                except (OSError, HTTPException):
                    self._reset()  # as if the store's own connection broke
                    return
                headers = {n: v for n, v in reply.getheaders() if n.lower() not in _HOP}
                happens = proxy._take_happening(self.path) if self.command == "GET" else None
                if self.command == "HEAD":
                    headers["Content-Length"] = reply.getheader("Content-Length", "0")
                self._answer(reply.status, headers, data, truncated=truncated or bool(happens))
                if happens is not None:
                    happens()
                    self._reset()

            def _ask(self, body: bytes) -> tuple[HTTPResponse, bytes]:
                host, port = str(proxy._upstream.hostname), proxy._upstream.port
                upstream = HTTPConnection(host, port, timeout=30)
                try:
                    skip = {"skip_host": True, "skip_accept_encoding": True}
                    upstream.putrequest(self.command, self.path, **skip)
                    for name, value in self.headers.items():  # as signed, the host among them
                        upstream.putheader(name, value)
                    upstream.endheaders(body or None)
                    with upstream.getresponse() as reply:  # it owns the socket once it is there
                        return reply, reply.read()
                finally:
                    upstream.close()

            def _answer(
                self,
                status: int,
                headers: Mapping[str, str],
                data: bytes,
                *,
                truncated: bool = False,
            ) -> None:
                self.send_response_only(status)
                for name, value in ({"Content-Length": str(len(data))} | dict(headers)).items():
                    self.send_header(name, value)
                self.end_headers()
                if self.command == "HEAD":
                    return
                self.wfile.write(data[: len(data) // 2] if truncated else data)
                self.close_connection = truncated

            def _reset(self) -> None:
                at_once = struct.pack("ii", 1, 0)
                self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, at_once)
                self.close_connection = True

        return Handler
