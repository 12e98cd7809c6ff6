"""Exports of a selection: the form that starts one, its progress, and the command that does it."""

from typing import Annotated, Any, cast
from urllib.parse import quote

from fastapi import APIRouter, Form
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response

from service.curation.verdicts import ChoicesReply
from service.errors import UsageError
from service.export.formats import FORMATS
from service.export.jobs import NO_PLACE, ExportJob, ExportJobs
from service.web.context import source_of, wants_json
from service.web.kept import Kept
from service.web.reviewer import Token, need_token

router = APIRouter()

Text = Annotated[str, Form()]


def exports_of(request: Request) -> ExportJobs | None:
    """Return the exports of the application; None: it has no folder for them."""
    return cast(ExportJobs | None, request.app.state.exports)


def export_context(request: Request, selection: str) -> dict[str, Any]:
    """Return what the page of a selection shows about exports.

    Returns:
        `formats` as (name, text, problem; empty: none), `jobs` of the selection, latest first, and
        `can_export`, false where the page has no folder for them.
    """
    jobs, has_logs = exports_of(request), bool(_bucket(request))
    return {
        "formats": [
            (each.name, each.text, _problem(each.name, has_logs=has_logs))
            for each in FORMATS.values()
        ],
        "jobs": jobs.jobs(selection) if jobs else [],
        "can_export": jobs is not None,
    }


def _problem(form: str, *, has_logs: bool) -> str:
    """Return why a format cannot be written from this page; empty if it can."""
    wanted = FORMATS[form]
    if wanted.reads_logs and not has_logs:
        return "reads the logs, whose bucket is not known"
    if wanted.check is not None:
        try:
            wanted.check()
        except UsageError as error:
            return str(error)
    return ""


def _bucket(request: Request) -> str:
    choices = cast(Kept[ChoicesReply], request.app.state.choices)
    return choices.of("", source_of(request).choices).bucket


@router.get("/data/exports")
def exports(request: Request, selection: str = "") -> Response:
    """Answer with the exports of a selection, or all, as JSON."""
    jobs = exports_of(request)
    found = jobs.jobs(selection or None) if jobs else []
    return JSONResponse({"jobs": [facts_of(each) for each in found]})


def facts_of(job: ExportJob) -> dict[str, Any]:
    """Return a job as JSON."""
    names = ("number", "selection", "out", "command", "scenes", "done", "text", "is_open")
    return {name: getattr(job, name) for name in names} | {
        "format": job.form,
        "state": job.state.value,
    }


@router.post("/exports")
def start_export(
    request: Request, token: Token = "", selection: Text = "", form: Text = ""
) -> Response:
    """Start an export of a selection, and go back to its page."""
    need_token(request, token)
    jobs = exports_of(request)
    if jobs is None:
        raise UsageError(NO_PLACE)
    found = source_of(request).selection(selection)
    job = jobs.start(found.name, form, scenes=len(found.scenes), bucket=_bucket(request))
    return _answer(request, job)


@router.post("/exports/stop")
def stop_export(
    request: Request, token: Token = "", selection: Text = "", number: Text = ""
) -> Response:
    """Stop an export; a second start goes on where it ended."""
    need_token(request, token)
    jobs = exports_of(request)
    if jobs is None:
        raise UsageError(NO_PLACE)
    if not (number.isascii() and number.isdecimal() and len(number) < 10):
        raise UsageError("an export has a number, as its page lists it")
    jobs.stop(int(number))
    job = next(each for each in jobs.jobs() if each.number == int(number))
    return _answer(request, job)


def _answer(request: Request, job: ExportJob) -> Response:
    if wants_json(request):
        return JSONResponse(facts_of(job))
    to = f"/selection?name={quote(job.selection, safe='')}#exports"
    return RedirectResponse(to, status_code=303)
