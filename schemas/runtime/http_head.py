"""Parser of HTTP request heads, bounded in time and size, which refuses malformed ones."""

import re
import socket
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from typing import Final
from urllib.parse import parse_qsl, unquote_to_bytes

HEAD_DEADLINE_S: Final = 5.0
"""Time for a client to send the whole head, in any number of packets, seconds."""

MAX_HEAD: Final = 8192
"""Bytes of request line and headers together; a browser or Prometheus sends under 2 KiB."""

MAX_HEADERS: Final = 64
"""Headers of a request."""

MAX_QUERY: Final = 2048
"""Bytes of a query before decoding; no page takes more than three short parameters."""

MAX_PARAMETERS: Final = 16
"""Parameters of a query."""

MAX_BODY: Final = 1 << 20
"""Bytes of a body, on pages that take one; a notice of a store has a few KiB."""

METHODS: Final = ("GET", "HEAD")


class RefusedRequestError(Exception):
    """A request that is answered by a status and a sentence instead of a page.

    Attributes:
        status: The HTTP status.
    """

    def __init__(self, sentence: str, *, status: HTTPStatus = HTTPStatus.BAD_REQUEST) -> None:
        """Keep the status; the sentence is the message."""
        super().__init__(sentence)
        self.status = status


@dataclass(frozen=True, slots=True)
class RequestHead:
    """The head of a request that some page may answer.

    Attributes:
        method: One of `METHODS`, or POST.
        path: Decoded, without the query.
        query: Parameters of the URL, decoded; none is given twice.
        headers: By name in lower case; of a repeated one the last.
    """

    method: str
    path: str
    query: Mapping[str, str]
    headers: Mapping[str, str]
    body_bytes: int = 0


def read_head(client: socket.socket, *, deadline_s: float) -> tuple[bytes, bytes]:
    """Read up to and without the empty line that ends a head.

    A request line that is malformed is refused before the rest of the head arrives.

    Args:
        client: The connection; its timeout is changed.
        deadline_s: When the head must be whole, on the monotonic clock, seconds.

    Returns:
        The lines of the head, nothing if the client left or never sent a byte; and what has
        arrived after it.

    Raises:
        RefusedRequestError: If the head is too long, comes too late, or does not begin as one.
        OSError: If the connection breaks.
    """
    head = b""
    line_is_known = False
    while len(head) <= MAX_HEAD:
        left_s = deadline_s - time.monotonic()
        try:
            client.settimeout(max(left_s, 1e-3))
            more = client.recv(MAX_HEAD) if left_s > 0 else None
        except TimeoutError:
            more = None
        if more is None:
            if not head:
                return b"", b""
            raise RefusedRequestError(
                "the request did not arrive in time; send its whole head at once",
                status=HTTPStatus.REQUEST_TIMEOUT,
            )
        if not more:
            return b"", b""
        head += more
        end = _END.search(head)
        if end is not None and end.start() <= MAX_HEAD:
            return head[: end.start()], head[end.end() :]
        if not line_is_known and b"\n" in head:
            _request_line(head.partition(b"\n")[0].removesuffix(b"\r"))
            line_is_known = True
    raise RefusedRequestError(
        f"the head of a request has at most {MAX_HEAD} bytes; ask with a shorter URL and fewer "
        "headers"
    )


def read_body(client: socket.socket, begun: bytes, *, body_bytes: int, deadline_s: float) -> bytes:
    """Read the rest of a body.

    Raises:
        RefusedRequestError: If it comes too late, or not whole.
        OSError: If the connection breaks.
    """
    body = begun
    while len(body) < body_bytes:
        try:
            client.settimeout(max(deadline_s - time.monotonic(), 1e-3))
            more = client.recv(1 << 16)
        except TimeoutError:
            more = b""
        if not more:
            raise RefusedRequestError(
                "the body did not arrive whole and in time", status=HTTPStatus.REQUEST_TIMEOUT
            )
        body += more
    return body[:body_bytes]


def parse_head(head: bytes, *, takes_body: Collection[str] = ()) -> RequestHead:
    """Parse the head of a request.

    Args:
        head: Its lines.
        takes_body: Paths that are asked with POST and a body.

    Raises:
        RefusedRequestError: If it is malformed, or has a body or a method that its path has not.
    """
    first, *lines = (line.removesuffix(b"\r") for line in head.split(b"\n"))
    method, target = _request_line(first)
    if len(lines) > MAX_HEADERS:
        raise RefusedRequestError(f"a request has at most {MAX_HEADERS} headers")
    headers = dict(map(_header, lines))
    path, _, query = target.partition("?")
    if len(query) > MAX_QUERY:
        raise RefusedRequestError(f"a query has at most {MAX_QUERY} bytes")
    if _decoded(path) in takes_body:
        body_bytes = _body_bytes(method, headers)
        return RequestHead(method, _decoded(path), _parameters(query), headers, body_bytes)
    if method not in METHODS:
        raise RefusedRequestError(
            f"pages are asked with {' or '.join(METHODS)}, not with {method}",
            status=HTTPStatus.METHOD_NOT_ALLOWED,
        )
    if "transfer-encoding" in headers or headers.get("content-length", "0").strip("0"):
        raise RefusedRequestError("a question to this endpoint has no body; put it into the URL")
    return RequestHead(method, _decoded(path), _parameters(query), headers)


_END: Final = re.compile(rb"\n\r?\n")

_LINE: Final = re.compile(rb"([!#$%&'*+.^_`|~0-9A-Za-z-]{1,32}) ([!-~]+) HTTP/1\.[0-9]")

_HEADER: Final = re.compile(rb"([!#$%&'*+.^_`|~0-9A-Za-z-]+):[ \t]*([\t -~\x80-\xff]*?)[ \t]*")


def _body_bytes(method: str, headers: Mapping[str, str]) -> int:
    if method != "POST":
        raise RefusedRequestError(
            "this page takes POST alone", status=HTTPStatus.METHOD_NOT_ALLOWED
        )
    length = headers.get("content-length", "")
    if "transfer-encoding" in headers or not (length.isdecimal() and length.isascii()):
        raise RefusedRequestError(
            "a body needs its Content-Length", status=HTTPStatus.LENGTH_REQUIRED
        )
    if len(length) > 12 or int(length) > MAX_BODY:
        raise RefusedRequestError(
            f"a body has at most {MAX_BODY} bytes", status=HTTPStatus.REQUEST_ENTITY_TOO_LARGE
        )
    return int(length)


def _request_line(line: bytes) -> tuple[str, str]:
    matched = _LINE.fullmatch(line)
    if matched is None:
        raise RefusedRequestError(
            "this is no request of HTTP/1.0 or HTTP/1.1; its first line reads GET /PATH HTTP/1.1"
        )
    target = matched[2].decode("ascii")
    if not target.startswith("/") or "#" in target:
        raise RefusedRequestError(
            "this endpoint is no proxy; ask it for a path that begins with / and has no #"
        )
    return matched[1].decode("ascii"), target


def _header(line: bytes) -> tuple[str, str]:
    matched = _HEADER.fullmatch(line)
    if matched is None:
        raise RefusedRequestError("a header is malformed; each is one line that reads NAME: VALUE")
    return matched[1].decode("ascii").lower(), matched[2].decode("latin-1")


def _decoded(path: str) -> str:
    if re.search(r"%(?![0-9A-Fa-f]{2})", path):
        raise RefusedRequestError("a % of the URL is not followed by two hexadecimal digits")
    try:
        text = unquote_to_bytes(path).decode("utf-8")
    except UnicodeDecodeError:
        raise RefusedRequestError("the URL is not UTF-8 once its % are decoded") from None
    if any(ord(letter) < 32 or ord(letter) == 127 for letter in text):
        raise RefusedRequestError("the URL holds a NUL or another control character")
    return text


def _parameters(query: str) -> dict[str, str]:
    _decoded(query)
    try:
        pairs = parse_qsl(query, keep_blank_values=True, max_num_fields=MAX_PARAMETERS)
    except ValueError:
        raise RefusedRequestError(f"a query has at most {MAX_PARAMETERS} parameters") from None
    parameters: dict[str, str] = {}
    for name, value in pairs:
        if name in parameters:
            raise RefusedRequestError(f"the parameter {name!r} is given twice; give it once")
        parameters[name] = value
    return parameters
