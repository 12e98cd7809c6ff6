"""Small HTTP endpoint of a daemon: a table of paths, each answered by a function."""

import json
import socket
import ssl
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from email.utils import formatdate
from http import HTTPStatus
from socketserver import BaseRequestHandler, TCPServer, ThreadingMixIn
from types import TracebackType
from typing import Any, Final, Self

import structlog
from prometheus_client import CollectorRegistry
from prometheus_client.exposition import choose_encoder

from schemas.errors import PermanentError, TransientError
from schemas.runtime.http_clients import MOST_CONNECTIONS, Clients
from schemas.runtime.http_guard import CHALLENGE, NEEDS_TOKEN, PageGuard
from schemas.runtime.http_head import (
    HEAD_DEADLINE_S,
    METHODS,
    RefusedRequestError,
    RequestHead,
    parse_head,
    read_body,
    read_head,
)

log = structlog.get_logger(__name__)

SEND_DEADLINE_S: Final = 10.0
"""Time for a client to read the whole answer, seconds."""

MOST_ANSWERS: Final = 6
"""Answers of one page made at a time; further clients are asked to come again. Four pages together
stay below the connections of one address, so that a probe always gets one.
"""

UNLOCKED: Final = PageGuard()
"""Guard of pages on the loopback: plain HTTP, and no token."""

TEXT: Final = "text/plain; charset=utf-8"
JSON: Final = "application/json"


@dataclass(frozen=True, slots=True)
class HttpRequest:
    """The parts of a request that a handler sees.

    Attributes:
        query: Parameters of the URL, decoded; none is given twice.
        accept: The `Accept` header; empty when there is none.
        body: The body, on a page that takes one.
    """

    query: Mapping[str, str] = field(default_factory=dict)
    accept: str = ""
    body: bytes = b""


@dataclass(frozen=True, slots=True)
class HttpResponse:
    """Response of a handler: status code, content type and body."""

    status: int
    content_type: str
    body: bytes


Handler = Callable[[HttpRequest], HttpResponse]
"""Function that answers one path. A `PermanentError` of its own becomes 400, a `TransientError`
503, each with its sentence; any other error is 500, and is logged.
"""


class HttpEndpoint:
    """Serves paths on one address, each request in a thread of its own, within a `with` block.

    GET and HEAD, POST where a page takes a body; one request per connection, no access log. The
    handlers may be called from several threads at once. Slow and silent clients make room for
    newcomers (`Clients`).

    Attributes:
        port: The port it listens on, also where the system chose it.
        url: `http://host:port`, or `https://host:port`.
    """

    def __init__(
        self,
        listen: str,
        routes: Mapping[str, Handler],
        *,
        setting: str = "http_listen",
        guard: PageGuard = UNLOCKED,
        posts: Mapping[str, Handler] | None = None,
    ) -> None:
        """Open the socket; nothing is answered before the block is entered.

        Args:
            listen: `host:port`; port 0 takes a free one, an IPv6 host is in brackets, and no host
                means every address of the machine.
            routes: Path to handler.
            setting: Name of the setting that gave the address, for errors.
            guard: TLS and tokens of the pages.
            posts: Path to handler of pages that are asked with POST and a body.

        Raises:
            PermanentError: If `listen` is no address.
            TransientError: If the address cannot be listened on: in use, of another machine, name
                unknown.
        """
        host, port = _address(listen, setting=setting)
        try:
            self._server = _Server(host, port, routes, guard, posts or {})
        except OSError as error:
            raise TransientError(
                f"cannot serve HTTP on {listen}: {error.strerror or error}; "
                f"free that address, or name another with the setting {setting} "
                f"(COUNTERPOINT_{setting.upper()})"
            ) from error
        self.port: int = self._server.server_address[1]
        scheme = "http" if guard.tls is None else "https"
        self.url = f"{scheme}://{f'[{host}]' if ':' in host else host or '127.0.0.1'}:{self.port}"
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": _POLL_S}, name="http"
        )

    def __enter__(self) -> Self:
        """Start answering."""
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the endpoint."""
        self.close()

    def close(self) -> None:
        """Refuse new requests, drop open ones and end every thread; a second call does nothing."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()
            self._server.clients.drop_all()
        self._server.server_close()


def metrics_route(*registries: CollectorRegistry) -> Handler:
    """Make the handler of `/metrics`: these registries, in this order and the requested format.

    Two registries must not contain the same metric.
    """

    def answer(request: HttpRequest) -> HttpResponse:
        encode, content_type = choose_encoder(request.accept)
        pages = [encode(registry) for registry in registries]
        # OpenMetrics ends a page with a mark, which may stand only once, at the very end.
        joined = b"".join(page.removesuffix(_END) for page in pages)
        ended = bool(pages) and pages[-1].endswith(_END)
        return HttpResponse(HTTPStatus.OK, content_type, joined + (_END if ended else b""))

    return answer


def json_response(data: Any, *, status: int = HTTPStatus.OK) -> HttpResponse:
    """Answer with JSON."""
    return HttpResponse(status, JSON, json.dumps(data).encode() + b"\n")


def text_response(text: str, *, status: int = HTTPStatus.OK) -> HttpResponse:
    """Answer with a line of text."""
    return HttpResponse(status, TEXT, text.encode() + b"\n")


_END: Final = b"# EOF\n"

_POLL_S: Final = 0.1
"""Interval at which a closing endpoint is noticed, seconds."""

_HEAR_OUT_S: Final = 1.0
"""Time for a client to hang up after its answer, seconds."""

_HEARD_BYTES: Final = 1 << 16


class _Server(ThreadingMixIn, TCPServer):
    allow_reuse_address = True
    daemon_threads = False  # so that closing waits for the threads
    block_on_close = True
    request_queue_size = 2 * MOST_CONNECTIONS

    def __init__(
        self,
        host: str,
        port: int,
        routes: Mapping[str, Handler],
        guard: PageGuard,
        posts: Mapping[str, Handler],
    ) -> None:
        self.routes, self.guard = {**routes, **posts}, guard
        self.posts = frozenset(posts)
        self.places = {path: threading.BoundedSemaphore(MOST_ANSWERS) for path in self.routes}
        self.clients = Clients()
        family, _, _, _, address = socket.getaddrinfo(
            host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        self.address_family = family
        super().__init__((str(address[0]), int(address[1])), _Request)

    def process_request(self, request: Any, client_address: Any) -> None:
        if self.clients.admit(request, str(client_address[0])):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def shutdown_request(self, request: Any) -> None:
        self.clients.forget(request)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        # Called while an exception ends a request; a client that left or is stuck is none of ours.
        error = sys.exception()
        said = log.debug if isinstance(error, OSError) else log.error
        said("request ended early", client=str(client_address), problem=repr(error))


class _Request(BaseRequestHandler):
    server: _Server
    request: socket.socket

    def handle(self) -> None:
        """Answer the single request of a connection."""
        if self.server.guard.tls is None:
            self._handle()
            return
        plain, tls = self.request, self.server.guard.tls
        wrapped = tls.wrap_socket(plain, server_side=True, do_handshake_on_connect=False)
        with wrapped as self.request:
            self.server.clients.replace(plain, wrapped)
            try:
                wrapped.settimeout(HEAD_DEADLINE_S)
                wrapped.do_handshake()
                self._handle()
            finally:
                self.server.clients.forget(self.request)

    def _handle(self) -> None:
        has_body = True
        try:
            deadline_s = time.monotonic() + HEAD_DEADLINE_S
            head, begun = read_head(self.request, deadline_s=deadline_s)
            if not head:
                return
            has_body = not head.startswith(b"HEAD ")
            asked = parse_head(head, takes_body=self.server.posts)
            answer = self._refused(asked) or self._answered(asked, begun)
        except RefusedRequestError as refused:
            answer = text_response(str(refused), status=refused.status)
        self._send(answer, has_body=has_body)

    def _refused(self, asked: RequestHead) -> HttpResponse | None:
        if self.server.guard.admits(asked.path, asked.headers):
            return None
        return text_response(NEEDS_TOKEN, status=HTTPStatus.UNAUTHORIZED)

    def _body(self, asked: RequestHead, begun: bytes) -> bytes:
        if asked.body_bytes > len(begun) and "expect" in asked.headers:
            self.request.sendall(b"HTTP/1.1 100 Continue\r\n\r\n")
        deadline_s = time.monotonic() + HEAD_DEADLINE_S
        return read_body(self.request, begun, body_bytes=asked.body_bytes, deadline_s=deadline_s)

    def _answered(self, asked: RequestHead, begun: bytes) -> HttpResponse:
        handler = self.server.routes.get(asked.path)
        if handler is None:
            paths = ", ".join(sorted(self.server.routes))
            return text_response(f"no such page; known pages: {paths}", status=HTTPStatus.NOT_FOUND)
        place = self.server.places[asked.path]
        if not place.acquire(blocking=False):
            return text_response(
                f"{MOST_ANSWERS} others wait for this page already; ask again",
                status=HTTPStatus.SERVICE_UNAVAILABLE,
            )
        try:
            body = self._body(asked, begun) if asked.body_bytes else b""
            self.server.clients.is_answered(self.request, True)
            return handler(HttpRequest(asked.query, asked.headers.get("accept", ""), body))
        except RefusedRequestError:
            raise
        except PermanentError as error:
            return text_response(str(error), status=HTTPStatus.BAD_REQUEST)
        except TransientError as error:
            return text_response(str(error), status=HTTPStatus.SERVICE_UNAVAILABLE)
        except Exception:
            log.exception("page failed", path=asked.path)
            return text_response(
                "this page failed; the log of the daemon has the cause",
                status=HTTPStatus.INTERNAL_SERVER_ERROR,
            )
        finally:
            self.server.clients.is_answered(self.request, False)
            place.release()

    def _send(self, answer: HttpResponse, *, has_body: bool) -> None:
        allowed = answer.status == HTTPStatus.METHOD_NOT_ALLOWED
        not_known = answer.status == HTTPStatus.UNAUTHORIZED
        lines = (
            f"HTTP/1.1 {answer.status} {HTTPStatus(answer.status).phrase}",
            "Server: counterpoint",
            f"Date: {formatdate(usegmt=True)}",
            f"Content-Type: {answer.content_type}",
            f"Content-Length: {len(answer.body)}",
            "Cache-Control: no-store",
            *((f"Allow: {', '.join(METHODS)}",) if allowed else ()),
            *((f"WWW-Authenticate: {CHALLENGE}",) if not_known else ()),
            "Connection: close",
        )
        head = "\r\n".join((*lines, "", "")).encode("ascii")
        self.request.settimeout(SEND_DEADLINE_S)  # of all of it: sendall counts from its begin
        self.request.sendall(head + answer.body if has_body else head)
        self._hear_out()

    def _hear_out(self) -> None:
        """Read the rest of the request; if closed earlier, the client would not see the answer."""
        deadline_s = time.monotonic() + _HEAR_OUT_S
        with suppress(OSError):  # it has its answer, or has left
            if isinstance(self.request, ssl.SSLSocket):
                self.request.settimeout(_HEAR_OUT_S)
                self.request = self.request.unwrap()  # so that the end of the answer is proven
            self.request.shutdown(socket.SHUT_WR)
            while (left_s := deadline_s - time.monotonic()) > 0:
                self.request.settimeout(left_s)
                if not self.request.recv(_HEARD_BYTES):
                    return


def _address(listen: str, *, setting: str) -> tuple[str, int]:
    host, colon, port = listen.rpartition(":")
    if not colon or not port.isdecimal() or int(port) > 65_535:
        raise PermanentError(
            f"not an address to serve HTTP on: {listen!r}; the setting {setting} wants host:port"
        )
    return host.removeprefix("[").removesuffix("]"), int(port)
