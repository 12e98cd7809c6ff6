"""Assembly of the review page: guard, static files, templates, and the routes of each page."""

from threading import Event
from typing import Final

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from schemas.errors import PermanentError, TransientError
from service.api.overlay_cache import OpenOverlays
from service.api.reader import Reader
from service.api.routes import PREFIX
from service.curation.verdicts import ChoicesReply
from service.errors import NothingFoundError
from service.export.jobs import ExportJobs
from service.http.app import make_api
from service.http.problems import problem
from service.http.signed_in import admits
from service.web import (
    agreement,
    dashboard,
    exports,
    live,
    ranking,
    reviewer,
    scene_page,
    selections,
    thumbnails,
    verdicts,
)
from service.web.context import STATIC, environment, render, wants_json
from service.web.gate import Gate
from service.web.kept import Kept
from service.web.progress import Progress
from service.web.security import Guard
from service.web.settings import WebSettings
from service.web.static_files import StaticFiles
from service.web.visitor import Visitors

PAGES: Final = (
    ranking,
    scene_page,
    dashboard,
    selections,
    exports,
    agreement,
    verdicts,
    thumbnails,
    live,
    reviewer,
)
"""Modules of pages, each with its `router`."""

NO_PAGE: Final = "there is no such page"


def make_app(source: Reader, settings: WebSettings, jobs: ExportJobs | None = None) -> FastAPI:
    """Make the application of one review page.

    Args:
        source: State or service whose scenes are reviewed; its methods are called from threads.
        settings: Address, hosts and key of the page.
        jobs: Exports in the background; None: the page has no folder for them.
    """
    app = FastAPI(
        title="Counterpoint review",
        docs_url=None,
        redoc_url=None,
        openapi_url=None,
        middleware=[
            Middleware(Guard, hosts=settings.hosts),
            Middleware(Gate, doors=settings.doors, rate=settings.rate),
        ],
    )
    app.state.source, app.state.settings = source, settings
    app.state.closing, app.state.thumbnails = Event(), thumbnails.Thumbnails()
    app.state.overlays, app.state.exports = OpenOverlays(), jobs
    app.state.progress, app.state.newest = Progress(), live.Newest()
    app.state.choices = Kept[ChoicesReply](age_s=ranking.KEPT_S)
    app.state.activity = Kept[dashboard.Shown](age_s=dashboard.KEPT_S)
    app.state.visitors, app.state.templates = (
        Visitors(settings.key, is_secure=settings.is_secure),
        environment(),
    )
    for page in PAGES:
        app.include_router(page.router)
    app.add_route("/static/{path:path}", StaticFiles(STATIC).answer)
    app.mount(PREFIX, make_api(source, app.state.overlays, admit=admits, jobs=jobs), name="api")
    app.add_exception_handler(PermanentError, _refused)
    app.add_exception_handler(TransientError, _later)
    app.add_exception_handler(HTTPException, _no_page)
    app.add_exception_handler(RequestValidationError, _malformed)
    return app


def problem_page(request: Request, sentence: str, *, status: int) -> Response:
    """Answer with a sentence: JSON for a script, a page for a person."""
    if wants_json(request):
        return JSONResponse({"problem": sentence}, status_code=status)
    return render(
        request, "problem.html", status=status, sentence=sentence, code=status, progress=""
    )


def _refused(request: Request, error: Exception) -> Response:
    status = 404 if isinstance(error, NothingFoundError) else 400
    status = 403 if isinstance(error, reviewer.ForbiddenError) else status
    return problem_page(request, str(error), status=status)


def _later(request: Request, error: Exception) -> Response:
    return problem_page(request, f"try again later: {error}", status=503)


def _no_page(request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 404
    sentence = NO_PAGE if status == 404 else str(getattr(error, "detail", NO_PAGE))
    if request.url.path.startswith(f"{PREFIX}/"):  # such as an address with a line break
        return problem(sentence, status=status)
    return problem_page(request, sentence, status=status)


def _malformed(request: Request, error: Exception) -> Response:
    return problem_page(request, "this address lacks a part, or has one too many", status=400)
