"""Routes of verdicts: list, add, undo, and what they add up to."""

import secrets
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from schemas.verdict import WriteKey
from service.curation.verdicts import (
    AgreementRequest,
    JudgeRequest,
    UndoRequest,
    VerdictsRequest,
)
from service.errors import UsageError
from service.http.context import IdempotencyKey, answer, next_page, route, source_of, turn_of
from service.http.signed_in import person_of

router = APIRouter(tags=["verdicts"])


class JudgeBody(JudgeRequest):
    """Verdict on a scene or track; the key may be in the header instead."""

    key: WriteKey = ""


class UndoBody(UndoRequest):
    """Undo of a verdict; the key may be in the header instead."""

    key: WriteKey = ""


@route(router, "verdicts", summary="List verdicts")
def verdicts(request: Request, asked: Annotated[VerdictsRequest, Query()]) -> Response:
    """List verdicts, latest first, page by page; `next` is `before` of the next page."""
    found = source_of(request).verdicts(asked)
    headers = next_page(request, before=found.next) if found.next is not None else {}
    return answer(found, headers=headers)


@route(router, "judge", summary="Judge a scene or track", status_code=201)
def judge(request: Request, asked: JudgeBody, key: IdempotencyKey = None) -> Response:
    """Store a verdict; the same request again, by its key, is stored once."""
    body = asked.model_copy(update=_own(request) | {"key": _key(key, asked.key)})
    return answer(source_of(request).judge(JudgeRequest(**body.model_dump())), status=201)


@route(router, "undo", summary="Undo a verdict", status_code=201)
def undo(request: Request, asked: UndoBody, key: IdempotencyKey = None) -> Response:
    """Undo a reviewer's last verdict: of one scene or track, or of all."""
    body = asked.model_copy(update=_own(request) | {"key": _key(key, asked.key)})
    return answer(source_of(request).undo(UndoRequest(**body.model_dump())), status=201)


@route(router, "agreement", summary="Agreement of reviewers")
def agreement(request: Request, asked: Annotated[AgreementRequest, Query()]) -> Response:
    """Return agreement, conflicts, pace and precision of the verdicts that count."""
    with turn_of(request) as source:
        return answer(source.agreement(asked))


@route(router, "choices", summary="Values of filters and verdicts")
def choices(request: Request) -> Response:
    """Return the values that filters and verdicts choose from."""
    return answer(source_of(request).choices())


def _own(request: Request) -> dict[str, str]:
    """Return the reviewer of a verdict where someone is signed in: no one judges for another."""
    person = person_of(request)
    return {} if person is None else {"reviewer": person.name}


def _key(header: str | None, body: str) -> str:
    """Return the key of a write; a new one where none is given.

    Raises:
        UsageError: If header and body have different ones.
    """
    if header and body and header != body:
        raise UsageError("the header Idempotency-Key and the field key differ: give one of them")
    return header or body or secrets.token_urlsafe(18)
