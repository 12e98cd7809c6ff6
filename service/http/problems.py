"""Errors of the REST API: one sentence each, as problem details.

Source: RFC 9457, Problem Details for HTTP APIs.
"""

from http import HTTPStatus
from typing import Any, Final

import structlog
from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, Field
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from schemas.bounds import Said, Text
from schemas.errors import CounterpointError, TransientError
from service.api.routes import IDEMPOTENCY_KEY
from service.errors import NothingFoundError

log = structlog.get_logger(__name__)

MEDIA_TYPE: Final = "application/problem+json"

RETRY_AFTER_S: Final = 2
"""Seconds that a client is asked to wait after a failure that may pass."""

FAILED: Final = "the request failed; the log of counterpoint review has the cause"

_MISSING: Final = ("no current scene ", "no selection '", 'no selection "', "no overlay of ")
_EXISTS: Final = ("selection ", " exists: ")
"""Parts of sentences by which an error keeps its status when it comes over the bus, which carries
the sentence without its class.
"""

_SENTENCES: Final = {
    404: "there is no such resource; /api/v1/openapi.json lists all",
    405: "this resource is not asked by this method; /api/v1/openapi.json lists them",
    400: "the body of the request cannot be read: it must be one JSON object within the bounds, "
    "sent as application/json",
}


class ForbiddenError(CounterpointError):
    """The caller lacks the permission that a request needs."""


class ConflictError(CounterpointError):
    """The request contradicts one that was stored before."""


class ProblemDetails(BaseModel):
    """Body of every error."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    type: Said = Field(default="about:blank", description="Always `about:blank`.")
    title: Said = Field(description="Phrase of the status.")
    status: int = Field(ge=400, le=599, description="Status of the response.")
    detail: Text = Field(description="One sentence: what, where, and what to do.")


def problem(sentence: str, *, status: int, headers: dict[str, str] | None = None) -> Response:
    """Answer with a sentence."""
    details = ProblemDetails(title=HTTPStatus(status).phrase, status=status, detail=sentence)
    content = details.model_dump(mode="json")
    return JSONResponse(content, status, headers=headers, media_type=MEDIA_TYPE)


def status_of(error: Exception) -> int:
    """Return the status of an error raised on purpose."""
    sentence = str(error)
    if isinstance(error, TransientError):
        return 503
    if isinstance(error, ForbiddenError):
        return 403
    if isinstance(error, NothingFoundError) or sentence.startswith(_MISSING):
        return 404
    exists = sentence.startswith(_EXISTS[0]) and _EXISTS[1] in sentence
    return 409 if exists or isinstance(error, ConflictError) else 400


def add_handlers(app: FastAPI) -> None:
    """Answer every error of an application with problem details."""
    app.add_exception_handler(CounterpointError, _raised_on_purpose)
    app.add_exception_handler(HTTPException, _of_http)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(Exception, _fault)


def describe_errors(app: FastAPI) -> None:
    """Let the OpenAPI document of an application name the media type that its errors have."""
    described = app.openapi

    def openapi() -> dict[str, Any]:
        document = described()
        for methods in document["paths"].values():
            for operation in methods.values():
                content = operation["responses"].get("default", {}).get("content", {})
                if "application/json" in content:
                    content[MEDIA_TYPE] = content.pop("application/json")
        return document

    app.openapi = openapi  # type: ignore[method-assign]


def _raised_on_purpose(request: Request, error: Exception) -> Response:
    status = status_of(error)
    if status == 503:
        again = {"retry-after": str(RETRY_AFTER_S)}
        return problem(f"try again later: {error}", status=status, headers=again)
    return problem(str(error), status=status)


def _of_http(request: Request, error: Exception) -> Response:
    status = getattr(error, "status_code", 500)
    sentence = _SENTENCES.get(status, str(getattr(error, "detail", "")))
    return problem(sentence, status=status, headers=getattr(error, "headers", None))


def _invalid(request: Request, error: Exception) -> Response:
    if not isinstance(error, RequestValidationError) or not error.errors():
        return problem(_SENTENCES[400], status=400)
    first = error.errors()[0]
    if first["type"] == "json_invalid" or first["loc"] == ("body",):
        return problem(_SENTENCES[400], status=400)
    return problem(f"invalid request: {_place(first)}: {first['msg']}"[:500], status=422)


def _place(error: dict[str, Any]) -> str:
    """Name the invalid part of a request: the header or field, without the kind of its source."""
    source, *names = (str(part) for part in error["loc"])
    name = ".".join(names)
    if source == "header":
        return f"header {IDEMPOTENCY_KEY if 'idempotency' in name else name}"
    return (name or source)[:100]


def _fault(request: Request, error: Exception) -> Response:
    log.error("a request failed", path=request.url.path[:200], exc_info=error)
    return problem(FAILED, status=500)
