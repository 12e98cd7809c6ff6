"""Common parts of the routes: data source, permission, and the form of an answer."""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import BoundedSemaphore
from typing import Annotated, Any, Final, cast
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Header
from pydantic import BaseModel
from starlette.requests import Request
from starlette.responses import Response

from schemas.bounds import NO_NUL
from schemas.errors import TransientError
from schemas.transport.wire import encode
from schemas.verdict import MAX_KEY
from service.api.overlay_cache import OpenOverlays
from service.api.reader import Reader
from service.api.routes import PAGE_ROUTES, ROUTES, Access, Route
from service.api.verbs import VERBS
from service.export.jobs import ExportJobs
from service.http.problems import ForbiddenError, ProblemDetails

PATIENCE_S: Final = 5.0
"""Time that a request which reads the whole ledger waits for its turn, seconds."""

MOST_WAITING: Final = 8
"""Requests of that kind that wait at a time; 40 threads answer all requests."""

JSON: Final = "application/json"

Admit = Callable[[Request, Access], bool]
"""Returns true if the caller of a request has a permission."""


def everyone(request: Request, access: Access) -> bool:
    """Admit every caller: the guard of the page has checked host and origin."""
    return True


@dataclass(slots=True)
class Api:
    """Parts of one REST API.

    Attributes:
        source: State or service that is read; its methods are called from threads.
        overlays: Overlays that the process has open.
        admit: Decides on permissions.
        jobs: Exports in the background; None: the page has no folder for them.
        turn: One request that reads the whole ledger is answered at a time.
        waiting: Requests that may wait for their turn.
    """

    source: Reader
    overlays: OpenOverlays
    admit: Admit = everyone
    jobs: ExportJobs | None = None
    turn: BoundedSemaphore = field(default_factory=BoundedSemaphore)
    waiting: BoundedSemaphore = field(default_factory=lambda: BoundedSemaphore(MOST_WAITING))


def api_of(request: Request) -> Api:
    """Return the parts of the API."""
    return cast(Api, request.app.state.api)


def source_of(request: Request) -> Reader:
    """Return the data source of the API."""
    return api_of(request).source


@contextmanager
def turn_of(request: Request) -> Iterator[Reader]:
    """Take the turn of a request that reads the whole ledger, for a `with` block.

    Raises:
        TransientError: If other such requests take too long, or too many wait.
    """
    api = api_of(request)
    if not api.waiting.acquire(blocking=False):
        raise TransientError("too many requests that read the whole ledger wait")
    try:
        if not api.turn.acquire(timeout=PATIENCE_S):
            raise TransientError("another request that reads the whole ledger is being answered")
        try:
            yield api.source
        finally:
            api.turn.release()
    finally:
        api.waiting.release()


def route(router: APIRouter, verb: str, **options: Any) -> Callable[[Any], Any]:
    """Declare the function that answers a verb at its address, with its permission and its docs."""
    return _declared(router, verb, ROUTES[verb], VERBS[verb].reply, options)


def page_route(
    router: APIRouter, name: str, *, reply: type[BaseModel], **options: Any
) -> Callable[[Any], Any]:
    """Declare the function of a route that is no verb, with its permission and its docs."""
    return _declared(router, name, PAGE_ROUTES[name], reply, options)


def _declared(
    router: APIRouter,
    name: str,
    at: Route,
    reply: type[BaseModel] | None,
    options: dict[str, Any],
) -> Callable[[Any], Any]:
    def admitted(request: Request) -> None:
        if not api_of(request).admit(request, at.access):
            raise ForbiddenError(f"this request needs the permission to {at.access}")

    answers: dict[int | str, dict[str, Any]] = {
        "default": {"model": ProblemDetails, "description": "An error, in one sentence."}
    }
    return router.api_route(
        at.path.replace("{scene_id}", "{scene_id:path}"),
        methods=[at.method],
        operation_id=name,
        response_model=reply,
        dependencies=[Depends(admitted)],
        responses=answers | options.pop("responses", {}),
        **options,
    )


def answer(
    message: BaseModel, *, status: int = 200, headers: dict[str, str] | None = None
) -> Response:
    """Answer with a message, encoded as on the bus."""
    return Response(encode(message), status, headers=headers, media_type=JSON)


def next_page(request: Request, **changes: object) -> dict[str, str]:
    """Return the header that links to the next page.

    Source: RFC 8288, Web Linking.
    """
    kept = [(name, value) for name, value in request.query_params.multi_items()]
    query = urlencode([each for each in kept if each[0] not in changes] + list(changes.items()))
    return {"link": f'<{request.url.path}?{query}>; rel="next"'}


IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=MAX_KEY,
        pattern=NO_NUL,
        description="Unique name of this write; the same write again is stored once.",
    ),
]


def name_by(key: str) -> str:
    """Return the name of the selection that a key makes."""
    return f"selection-{hashlib.sha256(key.encode()).hexdigest()[:12]}"
