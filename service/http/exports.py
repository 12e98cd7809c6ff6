"""Routes of exports that run in the background of the page: list, start and stop."""

from typing import Annotated, Final

from fastapi import APIRouter, Path, Query
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response

from schemas.bounds import MAX_NAME, NO_NUL, Count, Kept, Name
from service.errors import UsageError
from service.export.jobs import MOST_KEPT, MOST_WAITING, NO_PLACE, ExportJob, ExportJobs, JobState
from service.http.context import answer, api_of, page_route, source_of

router = APIRouter(tags=["exports"])

MOST_NUMBER: Final = 10**9
"""Number of an export at most."""


class ExportsQuery(BaseModel):
    """Query of the exports."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    selection: Name | None = Field(default=None, description="Only exports of this selection.")


class ExportRequest(BaseModel):
    """Request to export a selection; the same request again goes on where it ended."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    selection: Name = Field(description="Name of a stored selection.")
    format: Annotated[str, Field(min_length=1, max_length=MAX_NAME, pattern=NO_NUL)] = Field(
        description="Name of a format, as `counterpoint export --help` lists them."
    )


class ExportRow(BaseModel):
    """One export and its progress."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    number: Count = Field(description="Its number, until the page is restarted.")
    selection: Kept
    format: Kept
    out: Kept = Field(description="Folder or URL that it writes.")
    command: Kept = Field(description="The command that does the same, for a shell.")
    state: JobState
    done: Count = Field(description="Scenes written so far.")
    scenes: Count = Field(description="Scenes of the selection.")
    text: Kept = Field(description="Its result, or what failed, in one sentence.")


class ExportsReply(BaseModel):
    """Exports since the start of the page."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    exports: tuple[ExportRow, ...] = Field(
        max_length=MOST_KEPT + MOST_WAITING + 1, description="The latest first."
    )


NumberInPath = Annotated[int, Path(ge=1, le=MOST_NUMBER, description="Number of the export.")]


@page_route(router, "exports", reply=ExportsReply, summary="List exports")
def exports(request: Request, asked: Annotated[ExportsQuery, Query()]) -> Response:
    """List the exports that this page started, with their progress, the latest first."""
    jobs = api_of(request).jobs
    found = jobs.jobs(asked.selection) if jobs else []
    return answer(ExportsReply(exports=tuple(_row(each) for each in found)))


@page_route(router, "start_export", reply=ExportRow, summary="Export a selection", status_code=202)
def start_export(request: Request, asked: ExportRequest) -> Response:
    """Start an export in the background, or return the one that writes the same already.

    Scenes that an earlier export wrote into the same folder are kept.
    """
    jobs = _jobs(request)
    source = source_of(request)
    found = source.selection(asked.selection)
    job = jobs.start(
        found.name, asked.format, scenes=len(found.scenes), bucket=source.choices().bucket
    )
    return answer(_row(job), status=202)


@page_route(router, "stop_export", reply=ExportRow, summary="Stop an export")
def stop_export(request: Request, number: NumberInPath) -> Response:
    """Stop an export; whole scenes stay, and the next start goes on."""
    jobs = _jobs(request)
    jobs.stop(number)
    return answer(_row(next(each for each in jobs.jobs() if each.number == number)))


def _jobs(request: Request) -> ExportJobs:
    jobs = api_of(request).jobs
    if jobs is None:
        raise UsageError(NO_PLACE)
    return jobs


def _row(job: ExportJob) -> ExportRow:
    return ExportRow(
        number=job.number,
        selection=job.selection,
        format=job.form,
        out=job.out,
        command=job.command,
        state=job.state,
        done=job.done,
        scenes=job.scenes,
        text=job.text,
    )
