"""Requests to the REST API: the verbs of the bus over HTTP, by the standard library alone."""

import time
from collections.abc import Mapping
from email.message import Message
from http.client import HTTPException, HTTPResponse
from types import MappingProxyType
from typing import IO, Any, Final
from urllib.error import HTTPError, URLError
from urllib.parse import quote, urlencode, urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from pydantic import BaseModel, ValidationError

from schemas.bounds import MAX_SCENES_ASKED
from schemas.errors import PermanentError, TransientError
from schemas.transport.overlay_codec import MAX_OVERLAY_BYTES
from schemas.transport.overlay_file import OverlayFile, open_overlay_file
from schemas.transport.wire import decode, encode
from service.api.messages import SceneRequest, checked_request
from service.api.routes import IDEMPOTENCY_KEY, PREFIX, ROUTES, Route
from service.client.client import PATIENCE_S, ControlClient
from service.errors import NothingFoundError, UsageError

TIMEOUT_S: Final = 120.0
"""Time in which a part of an answer has to come, seconds; modes of a large fleet take long."""

MAX_ANSWER_BYTES: Final = MAX_OVERLAY_BYTES
"""Bytes of one answer at most."""

_AGAIN_S: Final = 0.2
"""Wait before a request is sent again, seconds."""

_SENTENCE_CHARACTERS: Final = 1000

_NOTHING: Final[Mapping[str, str]] = MappingProxyType({})


class HttpClient(ControlClient):
    """Sends requests to the REST API of a review page.

    Every method raises `TransientError` when the page does not answer, and `PermanentError` when it
    refuses.
    """

    def __init__(self, url: str, *, token: str = "", timeout_s: float = TIMEOUT_S) -> None:
        """Keep the address of the page.

        Args:
            url: Address of the page, such as `http://127.0.0.1:8087`.
            token: Token that the page asks for; empty: none.
            timeout_s: Time in which a part of an answer has to come, seconds.

        Raises:
            UsageError: If it is no address.
        """
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname or parts.query:
            raise UsageError(f"no address of a page: {url!r}; it is like http://127.0.0.1:8087")
        super().__init__((url,), root="")
        self._url = url.rstrip("/").removesuffix(PREFIX)
        self._headers = {"authorization": f"Bearer {token}"} if token else {}
        self._timeout_s, self._opener = timeout_s, build_opener(_NoRedirect)

    def overlay_place(self, scene_id: str) -> str:
        """Return the URL of a scene's overlay, for messages."""
        return self._address(ROUTES["overlay"], {"scene_id": scene_id})

    def overlay_file(self, scene_id: str) -> OverlayFile:
        """Open the overlay of a current scene; its blocks are fetched by ranges of bytes."""
        asked = checked_request(SceneRequest, scene_id=scene_id)
        url = self.overlay_place(asked.scene_id)
        first = self._open(self._made(url, method="HEAD"))
        size, etag = int(first.headers["content-length"]), first.headers["etag"]
        first.close()

        def read(offset: int, length: int) -> bytes:
            if not length:
                return b""
            ranged = {"range": f"bytes={offset}-{offset + length - 1}", "if-match": etag}
            return self._body(self._made(url, ranged))

        return open_overlay_file(read, file_bytes=size, where=url)

    def _ask(self, verb: str, request: BaseModel | None = None) -> bytes:
        if (route := ROUTES.get(verb)) is None:
            raise UsageError(f"{verb} is not asked over HTTP: give the endpoint of a router")
        asked = self._request(verb, route, request)
        is_repeatable = route.method == "GET" or asked.has_header(IDEMPOTENCY_KEY.capitalize())
        give_up_s = time.monotonic() + PATIENCE_S
        while True:
            try:
                return self._body(asked)
            except TransientError:
                if not is_repeatable or time.monotonic() >= give_up_s:
                    raise
            time.sleep(_AGAIN_S)

    def _request(self, verb: str, route: Route, request: BaseModel | None) -> Request:
        fields: dict[str, Any] = {}
        if request is not None:
            fields = request.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
        url = self._address(route, fields)
        if route.method == "GET":
            query = _query(verb, fields, in_path=route.path)
            return self._made(f"{url}?{query}" if query else url)
        headers = {"content-type": "application/json"}
        if key := fields.get("key"):
            headers[IDEMPOTENCY_KEY] = key
        body = encode(request) if request is not None else b"{}"
        return self._made(url, headers, method="POST", body=body)

    def _made(
        self,
        url: str,
        headers: Mapping[str, str] = _NOTHING,
        *,
        method: str = "GET",
        body: bytes | None = None,
    ) -> Request:
        both = self._headers | dict(headers)
        return Request(url, data=body, headers=both, method=method)  # noqa: S310 - checked: HTTP

    def _address(self, route: Route, fields: Mapping[str, Any]) -> str:
        named = {name: quote(str(value), safe="") for name, value in fields.items()}
        return f"{self._url}{PREFIX}{route.path.format_map(named)}"

    def _body(self, request: Request) -> bytes:
        try:
            with self._open(request) as response:
                body = response.read(MAX_ANSWER_BYTES + 1)
        except (OSError, HTTPException) as error:
            raise _silence(self._url, error) from error
        if len(body) > MAX_ANSWER_BYTES:
            raise PermanentError(
                f"the answer is larger than {MAX_ANSWER_BYTES} bytes: ask for less"
            )
        return bytes(body)

    def _open(self, request: Request) -> HTTPResponse:
        try:
            opened: HTTPResponse = self._opener.open(request, timeout=self._timeout_s)
        except HTTPError as error:
            with error:
                raise _refusal(error, self._url) from None
        except (OSError, HTTPException) as error:
            raise _silence(self._url, error) from error
        return opened


class _NoRedirect(HTTPRedirectHandler):
    """Follows no redirection: a token must not reach another host."""

    def redirect_request(
        self, req: Request, fp: IO[bytes], code: int, msg: str, headers: Message, newurl: str
    ) -> None:
        return None


def _query(verb: str, fields: Mapping[str, Any], *, in_path: str) -> str:
    asked = {name: value for name, value in fields.items() if f"{{{name}}}" not in in_path}
    if verb != "rates":
        asked.pop("verdicts", None)  # over HTTP rows have their verdicts
    if verb == "top":
        asked.setdefault("most", MAX_SCENES_ASKED)
    return urlencode({name: _text(value) for name, value in asked.items()})


def _text(value: object) -> object:
    return str(value).lower() if isinstance(value, bool) else value


class _Details(BaseModel):
    """The part of problem details that is used."""

    detail: str


def _refusal(error: HTTPError, url: str) -> PermanentError | TransientError:
    """Return the error that the answer of a page describes."""
    body = error.read(2**16)
    try:
        sentence = decode(_Details, body).detail[:_SENTENCE_CHARACTERS]
    except ValidationError:
        return PermanentError(f"no REST API of Counterpoint answers at {url}: status {error.code}")
    if error.code >= 500:
        return TransientError(sentence)
    return NothingFoundError(sentence) if error.code == 404 else PermanentError(sentence)


def _silence(url: str, error: Exception) -> TransientError:
    why = error.reason if isinstance(error, URLError) else error
    return TransientError(f"no review page answers at {url}: {why or type(error).__name__}")
