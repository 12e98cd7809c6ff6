"""Common parts of every page: templates, the visitor, the token, and the form of an answer."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Final, cast

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from schemas.visible import visible
from service.api.reader import Reader
from service.http.signed_in import person_of
from service.web import phrases
from service.web.progress import progress_text
from service.web.settings import WebSettings
from service.web.visitor import Visitor, Visitors

HERE: Final = Path(__file__).resolve().parent
STATIC: Final = HERE / "static"


_AGAIN: Final = (
    '<!doctype html><meta http-equiv="refresh" content="0"><title>Counterpoint</title>'
    '<p>Opening the page. <a href="">Open it</a></p>'
)
"""Page that opens the same address again, from here, so that the browser sends the cookie."""


def _shown(value: object) -> object:
    """Make terminal escapes and marks of writing direction visible in whatever a template prints.

    Jinja escapes HTML in what this returns.
    """
    if isinstance(value, str) and not isinstance(value, Markup):
        return visible(value, keep="\n")
    return value


def environment() -> Environment:
    """Make the environment of the templates: everything printed is escaped and made visible."""
    made = Environment(
        loader=FileSystemLoader(HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_shown,
    )
    made.filters.update(phrases.FILTERS)
    return made


def source_of(request: Request) -> Reader:
    """Return the data source of the page."""
    return cast(Reader, request.app.state.source)


def settings_of(request: Request) -> WebSettings:
    """Return the settings of the page."""
    return cast(WebSettings, request.app.state.settings)


def visitors_of(request: Request) -> Visitors:
    """Return the reader of cookies."""
    return cast(Visitors, request.app.state.visitors)


def visitor_of(request: Request) -> Visitor:
    """Return the visitor of a request; one without a cookie of this state is new."""
    if not hasattr(request.state, "visitor"):
        visitors = visitors_of(request)
        known = visitors.of(request)
        request.state.visitor = signed_in(request, known or visitors.new())
        request.state.is_new = known is None
    return cast(Visitor, request.state.visitor)


def signed_in(request: Request, visitor: Visitor) -> Visitor:
    """Return the visitor under the name of who is signed in, which no form can change."""
    person = person_of(request)
    return visitor if person is None else replace(visitor, reviewer=person.name)


def page_context(request: Request, *, has_progress: bool = True) -> dict[str, Any]:
    """Return what `base.html` and the forms of every page need.

    Args:
        request: The request that is answered.
        has_progress: False for a page that states its progress, or has none.

    Returns:
        `token` of the forms, `reviewer`, `budget` and `theme` of the visitor. `place` is the state
        folder or the endpoint. `path` has its query, for forms to come back to. `section` is the
        page of the menu; empty: none. `progress` is a phrase of budget, pace and precision so far.
    """
    visitor = visitor_of(request)
    query = f"?{request.url.query}" if request.url.query else ""
    return {
        "request": request,
        "token": visitors_of(request).token(visitor),
        "reviewer": visitor.reviewer,
        "budget": visitor.budget,
        "theme": visitor.theme,
        "place": settings_of(request).place,
        "section": "",
        "progress": progress_text(request, reviewer=visitor.reviewer, budget=visitor.budget)
        if has_progress
        else "",
        "path": f"{request.url.path}{query}",
    }


def render(request: Request, template: str, *, status: int = 200, **context: Any) -> Response:
    """Answer with a page, and set the cookie of a visitor who has none of this state."""
    visitor_of(request)
    if request.state.is_new and request.headers.get("sec-fetch-site") == "cross-site":
        return HTMLResponse(_AGAIN)  # a page elsewhere has a link to us: the cookie was not sent
    templates = cast(Environment, request.app.state.templates)
    text = templates.get_template(template).render(
        page_context(request, has_progress="progress" not in context) | context
    )
    response = HTMLResponse(text, status_code=status)
    if request.state.is_new:
        visitors_of(request).keep(response, visitor_of(request))
    return response


def wants_json(request: Request) -> bool:
    """Return true if a script asks: for data, or with `Accept: application/json`."""
    is_data = request.url.path.startswith("/data/")
    return is_data or "application/json" in request.headers.get("accept", "")
