"""Forms about the reviewer: name and budget, and the colours of the page."""

from dataclasses import replace
from typing import Annotated, Final

from fastapi import APIRouter, Form
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from service.errors import UsageError
from service.http.signed_in import person_of
from service.web.context import visitor_of, visitors_of
from service.web.visitor import OTHER_STATE, THEMES, introduced

router = APIRouter()

Token = Annotated[str, Form()]
Back = Annotated[str, Form()]

HOME: Final = "/"


def need_token(request: Request, token: str) -> None:
    """Refuse a form that no page of this state made for this browser.

    Raises:
        ForbiddenError: If cookie and token do not belong together, or to this state.
    """
    visitors = visitors_of(request)
    if not visitors.accepts(visitors.of(request), token):
        raise ForbiddenError(OTHER_STATE)


class ForbiddenError(UsageError):
    """A form that is not one of this browser and this state."""


def way_back(back: str) -> str:
    """Return the path of this page to go back to; the ranking if it is of another site."""
    is_ours = back.startswith("/") and not back.startswith(("//", "/\\")) and back.isprintable()
    return back if is_ours else HOME


@router.post("/reviewer")
def set_reviewer(
    request: Request,
    token: Token = "",
    name: Annotated[str, Form()] = "",
    budget: Annotated[str, Form()] = "",
    back: Back = HOME,
) -> Response:
    """Store the name of the reviewer, and the budget, in the cookie."""
    need_token(request, token)
    response = RedirectResponse(way_back(back), status_code=303)
    visitor = visitor_of(request)
    name = visitor.reviewer if person_of(request) else name
    known = introduced(visitor, name=name, budget=budget)
    visitors_of(request).keep(response, known)
    return response


@router.post("/theme")
def set_theme(
    request: Request, token: Token = "", theme: Annotated[str, Form()] = "", back: Back = HOME
) -> Response:
    """Store the choice of colours in the cookie."""
    need_token(request, token)
    if theme not in THEMES:
        raise UsageError(f"colours are one of {', '.join(THEMES)}")
    response = RedirectResponse(way_back(back), status_code=303)
    visitors_of(request).keep(response, replace(visitor_of(request), theme=theme))
    return response
