"""Assembly of the REST API: an application that the review page mounts at `PREFIX`."""

from typing import Final

from fastapi import FastAPI

from service.api.overlay_cache import OpenOverlays
from service.api.reader import Reader
from service.export.jobs import ExportJobs
from service.http import audit, exports, reference, scenes, selections, sums, verdicts
from service.http.context import Admit, Api, everyone
from service.http.problems import add_handlers, describe_errors
from service.http.sums import PACKAGE

MODULES: Final = (scenes, selections, verdicts, sums, exports, audit)
"""Modules of routes, each with its `router`."""

ABOUT: Final = (
    "The verbs of Counterpoint over HTTP, with the answers that they have on the bus. Every error "
    "is one sentence in JSON (RFC 9457). Ids are stable, lists have cursors, and a write with a "
    "key is stored once."
)


def make_api(
    source: Reader,
    overlays: OpenOverlays,
    *,
    admit: Admit = everyone,
    jobs: ExportJobs | None = None,
) -> FastAPI:
    """Make the application of the REST API.

    Args:
        source: State or service that is read; its methods are called from threads.
        overlays: Overlays that the process has open.
        admit: Decides if a caller has the permission that a route needs.
        jobs: Exports in the background; None: the page has no folder for them.
    """
    app = FastAPI(
        title="Counterpoint",
        version=PACKAGE,
        description=ABOUT,
        docs_url=None,
        redoc_url=None,
        openapi_url="/openapi.json",
    )
    app.state.api = Api(source, overlays, admit, jobs)
    for module in MODULES:
        app.include_router(module.router)
    app.include_router(reference.router)
    add_handlers(app)
    describe_errors(app)
    return app
