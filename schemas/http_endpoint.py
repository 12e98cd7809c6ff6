"""A small HTTP endpoint for watchers of a daemon: a table of paths, each answered by a function."""

import json
import socket
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socketserver import TCPServer
from types import TracebackType
from typing import Any, Final, Self
from urllib.parse import parse_qsl, urlsplit

import structlog
from prometheus_client import CollectorRegistry
from prometheus_client.exposition import choose_encoder

from schemas.errors import PermanentError, TransientError

log = structlog.get_logger(__name__)

READ_TIMEOUT_S: Final = 5.0
"""A client that sends or takes nothing for so long is left."""

MOST_CONNECTIONS: Final = 16
"""Clients answered at a time; one more is sent away, so that stuck ones cannot pile up."""

TEXT: Final = "text/plain; charset=utf-8"
JSON: Final = "application/json"


@dataclass(frozen=True, slots=True)
class HttpRequest:
    """What a handler may know of the question.

    Attributes:
        query: Parameters of the URL, decoded; of a repeated one the last.
        accept: The `Accept` header; empty when there is none.
    """

    query: Mapping[str, str] = field(default_factory=dict)
    accept: str = ""


@dataclass(frozen=True, slots=True)
class HttpResponse:
    """An answer: status code, content type and body."""

    status: int
    content_type: str
    body: bytes


Handler = Callable[[HttpRequest], HttpResponse]
"""Answers one path. A `PermanentError` of its own becomes 400, a `TransientError` 503, each with
its sentence; any other error is 500, and is logged."""


class HttpEndpoint:
    """Serves paths on one address, each request in a thread of its own, within a `with` block.

    GET and HEAD only, one request per connection, no access log. The handlers may be called from
    several threads at once.

    Attributes:
        port: The port it listens on, also where the system chose it.
        url: `http://host:port`.
    """

    def __init__(
        self, listen: str, routes: Mapping[str, Handler], *, setting: str = "http_listen"
    ) -> None:
        """Open the socket; nothing is answered before the block is entered.

        Args:
            listen: `host:port`; port 0: one that is free, host in brackets if it is IPv6; no host:
                every address of the machine.
            routes: Path to handler.
            setting: Where the address came from, for errors.

        Raises:
            PermanentError: If `listen` is no address.
            TransientError: If it cannot be listened on: in use, not ours, name unknown.
        """
        host, port = _address(listen, setting=setting)
        try:
            self._server = _Server(host, port, routes)
        except OSError as error:
            raise TransientError(
                f"cannot serve HTTP on {listen}: {error.strerror or error}; "
                f"free that address, or name another with the setting {setting}"
            ) from error
        self.port: int = self._server.server_address[1]
        self.url = f"http://{f'[{host}]' if ':' in host else host or '127.0.0.1'}:{self.port}"
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": _POLL_S}, name="http"
        )

    def __enter__(self) -> Self:
        """Start to answer."""
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close."""
        self.close()

    def close(self) -> None:
        """Take no more questions, drop those still open, end every thread; again: do nothing."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()
            self._server.drop_clients()
        self._server.server_close()


def metrics_route(*registries: CollectorRegistry) -> Handler:
    """Make the handler of `/metrics`: these registries, one after the other, in the asked format.

    Two registries must not hold the same metric.
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
"""How soon a closing endpoint notices."""


class _Server(ThreadingHTTPServer):
    daemon_threads = False  # so that closing waits for the threads
    block_on_close = True
    request_queue_size = 2 * MOST_CONNECTIONS

    def __init__(self, host: str, port: int, routes: Mapping[str, Handler]) -> None:
        self.routes = dict(routes)
        self._clients: set[socket.socket] = set()
        self._guard = threading.Lock()
        family, _, _, _, address = socket.getaddrinfo(
            host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        self.address_family = family
        super().__init__((str(address[0]), int(address[1])), _Request)

    def server_bind(self) -> None:
        # Not HTTPServer's: that also asks the name service for our name, which may take seconds.
        TCPServer.server_bind(self)

    def process_request(self, request: Any, client_address: Any) -> None:
        with self._guard:
            full = len(self._clients) >= MOST_CONNECTIONS
            if not full:
                self._clients.add(request)
        if full:
            self.shutdown_request(request)
        else:
            super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        with self._guard:
            self._clients.discard(request)
        super().shutdown_request(request)

    def drop_clients(self) -> None:
        with self._guard:
            for client in self._clients:
                with suppress(OSError):  # it may have left this moment
                    client.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        # Called while an exception ends a request; a client that left or is stuck is none of ours.
        error = sys.exception()
        said = log.debug if isinstance(error, OSError) else log.error
        said("request ended early", client=str(client_address), problem=repr(error))


class _Request(BaseHTTPRequestHandler):
    timeout = READ_TIMEOUT_S
    server: _Server
    server_version = "counterpoint"
    sys_version = ""

    def do_GET(self) -> None:
        split = urlsplit(self.path)
        request = HttpRequest(dict(parse_qsl(split.query)), self.headers.get("Accept", ""))
        self._send(self._answered(split.path, request))

    do_HEAD = do_GET  # noqa: N815 -- the library's name

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 -- the library's name
        log.debug("http", request=format % args)

    def _answered(self, path: str, request: HttpRequest) -> HttpResponse:
        handler = self.server.routes.get(path)
        if handler is None:
            paths = ", ".join(sorted(self.server.routes))
            return text_response(f"no such page; there are: {paths}", status=HTTPStatus.NOT_FOUND)
        try:
            return handler(request)
        except PermanentError as error:
            return text_response(str(error), status=HTTPStatus.BAD_REQUEST)
        except TransientError as error:
            return text_response(str(error), status=HTTPStatus.SERVICE_UNAVAILABLE)
        except Exception:
            log.exception("page failed", path=path)
            return text_response(
                "this page failed; the log of the daemon says why",
                status=HTTPStatus.INTERNAL_SERVER_ERROR,
            )

    def _send(self, response: HttpResponse) -> None:
        self.send_response(response.status)
        self.send_header("Content-Type", response.content_type)
        self.send_header("Content-Length", str(len(response.body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(response.body)


def _address(listen: str, *, setting: str) -> tuple[str, int]:
    host, colon, port = listen.rpartition(":")
    if not colon or not port.isdecimal() or int(port) > 65_535:
        raise PermanentError(
            f"not an address to serve HTTP on: {listen!r}; the setting {setting} wants host:port"
        )
    return host.removeprefix("[").removesuffix("]"), int(port)
