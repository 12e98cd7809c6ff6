"""Guard of every request and answer: host, origin, size of a form, and the headers of an answer."""

from collections.abc import Iterable
from typing import Final
from urllib.parse import urlsplit

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from schemas.bounds import MAX_QUESTION_BYTES
from service.api.routes import PREFIX
from service.http.problems import problem

log = structlog.get_logger(__name__)

POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'"
)
"""Content security policy of every answer: nothing inline, nothing of another origin."""

HEADERS: Final = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
}

LOOPBACK: Final = frozenset({"localhost", "127.0.0.1", "::1"})

MAX_FORM_BYTES: Final = 2**18
"""Bytes of the body of a request at most; a verdict with its note has less than 20 KB."""

FAILED: Final = "this page failed; the log of counterpoint review has the cause"

_SAFE: Final = frozenset({"GET", "HEAD"})


class Guard:
    """ASGI middleware that refuses foreign requests, and sets the headers of every answer.

    The host of a request must be known, so that a name that another site points at this machine is
    refused. A form must come from a page of this host: browsers name the origin of every POST.
    """

    def __init__(self, app: ASGIApp, *, hosts: Iterable[str]) -> None:
        """Keep the application, and the names under which it may be asked in addition to LOOPBACK.

        Args:
            app: The application behind this guard.
            hosts: Names or addresses without a port; `*` accepts any.
        """
        self._app = app
        self._hosts = LOOPBACK | {host.lower() for host in hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        has_begun = False

        async def send_with_headers(message: Message) -> None:
            nonlocal has_begun
            has_begun = True
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers[name] = value
                is_static = scope["path"].startswith("/static/")  # asked again by its ETag
                headers.setdefault("cache-control", "no-cache" if is_static else "no-store")
            await send(message)

        most_bytes = MAX_QUESTION_BYTES if _is_api(scope) else MAX_FORM_BYTES
        found = self._problem(scope["method"], Headers(scope=scope), most_bytes=most_bytes)
        if found:
            await _refusal(scope, *found)(scope, receive, send_with_headers)
            return
        try:
            await self._app(scope, _bounded(receive, most_bytes), send_with_headers)
        except Exception:
            if has_begun:
                raise
            log.exception("a page failed", path=scope["path"])
            await _refusal(scope, 500, FAILED)(scope, receive, send_with_headers)

    def _problem(self, method: str, headers: Headers, *, most_bytes: int) -> tuple[int, str] | None:
        """Return the status and sentence with which a request is refused; None: it is not."""
        asked = headers.get("host", "")
        name = name_of(asked)
        if "*" not in self._hosts and name not in self._hosts:
            return 421, (
                f"this page is not served under the host {name[:100]!r}: name it in the setting "
                "review_hosts, or with --host when you start counterpoint review"
            )
        if method in _SAFE:
            return None
        if method != "POST":
            return 405, "only GET and POST are answered"
        if not _is_of_this_host(headers, asked):
            return 403, "this form was sent by a page of another site, and is refused"
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length[:12]) > most_bytes:
            return 413, f"a form has at most {most_bytes} bytes"
        return None


def _is_api(scope: Scope) -> bool:
    """Return true for a request to the REST API."""
    return str(scope["path"]).startswith(f"{PREFIX}/")


def _refusal(scope: Scope, status: int, sentence: str) -> Response:
    """Make the answer to a refused request: problem details from the REST API, text otherwise."""
    if _is_api(scope):
        return problem(sentence, status=status)
    return PlainTextResponse(f"{sentence}\n", status_code=status)


def name_of(host: str) -> str:
    """Return the name in a `Host` header, in lower case, without port and brackets."""
    try:
        return (urlsplit(f"//{host}").hostname or "").lower()
    except ValueError:
        return ""


def _is_of_this_host(headers: Headers, host: str) -> bool:
    """Return true for a request of a page of this host, or of a client that is no browser."""
    if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
        return False
    origin = headers.get("origin")
    if origin is None:
        return True
    scheme, _, netloc = origin.partition("://")
    return scheme in ("http", "https") and netloc.lower() == host.lower()


def _bounded(receive: Receive, most_bytes: int) -> Receive:
    """Cut off a body that is longer than its header states."""
    seen = 0

    async def receive_bounded() -> Message:
        nonlocal seen
        message = await receive()
        seen += len(message.get("body", b""))
        if seen > most_bytes:
            return {"type": "http.disconnect"}
        return message

    return receive_bounded
