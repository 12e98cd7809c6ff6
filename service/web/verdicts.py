"""Verdicts from the page: give one, or take the last one back."""

import secrets
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Form
from pydantic import BaseModel, ValidationError
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response

from schemas.transport.wire import first_problem
from schemas.verdict import VerdictRow
from service.curation.verdicts import JudgeRequest, UndoRequest
from service.errors import UsageError
from service.http.signed_in import person_of
from service.web.context import source_of, visitor_of, visitors_of, wants_json
from service.web.progress import progress_of, summary
from service.web.reviewer import HOME, Back, Token, need_token, way_back
from service.web.visitor import Visitor, introduced

router = APIRouter()

Text = Annotated[str, Form()]

Asked = TypeVar("Asked", bound=BaseModel)


@router.post("/verdict")
def judge(
    request: Request,
    token: Token = "",
    scene_id: Text = "",
    sha256: Text = "",
    track_id: Text = "",
    verdict: Text = "",
    cause: Text = "",
    note: Text = "",
    duplicate_of: Text = "",
    took_s: Text = "",
    key: Text = "",
    reviewer: Text = "",
    selection: Text = "",
    back: Back = HOME,
) -> Response:
    """Store a verdict; a form that is sent twice with one `key` is stored once."""
    need_token(request, token)
    visitor = _named(visitor_of(request), "" if person_of(request) else reviewer)
    asked = _checked(
        JudgeRequest,
        key=key or secrets.token_urlsafe(18),
        scene_id=scene_id,
        sha256=sha256,
        track_id=track_id,
        reviewer=visitor.reviewer,
        verdict=verdict,
        cause=cause,
        note=note.replace("\r\n", "\n").strip(),
        duplicate_of=duplicate_of.strip(),
        took_s=took_s,
    )
    stored = source_of(request).judge(asked)
    return _answer(request, visitor, stored, selection=selection, back=back)


@router.post("/undo")
def undo(
    request: Request,
    token: Token = "",
    scene_id: Text = "",
    track_id: Text = "",
    key: Text = "",
    selection: Text = "",
    back: Back = HOME,
) -> Response:
    """Take back the reviewer's last verdict: of a scene or track, or of all."""
    need_token(request, token)
    visitor = _named(visitor_of(request), "")
    asked = _checked(
        UndoRequest,
        key=key or secrets.token_urlsafe(18),
        reviewer=visitor.reviewer,
        scene_id=scene_id,
        track_id=track_id,
    )
    stored = source_of(request).undo(asked)
    return _answer(request, visitor, stored, selection=selection, back=back)


def _named(visitor: Visitor, name: str) -> Visitor:
    """Return the visitor under the name that a form brings, else under the known one.

    Raises:
        UsageError: If there is neither.
    """
    if name.strip() and name.strip() != visitor.reviewer:
        return introduced(visitor, name=name, budget=str(visitor.budget or ""))
    if not visitor.reviewer:
        raise UsageError(
            "verdicts have a name: give yours at the top of the page, then judge again"
        )
    return visitor


def _checked(kind: type[Asked], **fields: Any) -> Asked:
    """Make a request of the fields of a form, of which empty ones are not given.

    Raises:
        UsageError: If a value is missing or impossible.
    """
    try:
        return kind.model_validate({name: value for name, value in fields.items() if value != ""})
    except ValidationError as error:
        raise UsageError(f"this verdict is not possible: {first_problem(error)}") from None


def _answer(
    request: Request, visitor: Visitor, stored: VerdictRow, *, selection: str, back: str
) -> Response:
    """Answer with the stored event and the progress, or go back to the page of the form."""
    progress = progress_of(request)
    progress.forget()
    if wants_json(request):
        found = progress.of(source_of(request), selection)
        about = summary(found, reviewer=visitor.reviewer, budget=visitor.budget)
        response: Response = JSONResponse(
            {"stored": stored.model_dump(mode="json"), "progress": about}
        )
    else:
        response = RedirectResponse(way_back(back), status_code=303)
    if visitor.reviewer != visitor_of(request).reviewer:
        visitors_of(request).keep(response, visitor)
    return response
