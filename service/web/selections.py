"""Selections: the list of them, one of them, and the form that makes one."""

import time
from collections import defaultdict
from typing import Annotated, Final
from urllib.parse import quote

from fastapi import APIRouter, Form
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response

from schemas.bounds import MAX_SCENES_CHOSEN
from service.api.reader import Reader
from service.curation.audit import ExportedRequest
from service.curation.listing import MAX_PAGE
from service.curation.selection import Selection
from service.errors import UsageError
from service.export.json_lines import json_lines
from service.web.context import render, source_of, visitor_of, wants_json
from service.web.exports import export_context
from service.web.filters import Filters
from service.web.progress import progress_of, summary
from service.web.reviewer import need_token

router = APIRouter()

Text = Annotated[str, Form()]

PAGE: Final = 100
"""Scenes of a selection on one page."""

USUAL_BUDGET: Final = 50


@router.get("/selections")
def selections(request: Request) -> Response:
    """Answer with the list, and with the form for the filters of the address."""
    source, filters = source_of(request), Filters.of(request.query_params)
    asked = filters.request(
        reviewer=visitor_of(request).reviewer,
        now_s=time.clock_gettime(time.CLOCK_REALTIME),
        most=1,
        after="",
    )
    listed = source.scenes(asked)
    total = listed.total
    return render(
        request,
        "selections.html",
        section="selections",
        found=list(reversed(source.selections())),
        filters=filters,
        hidden={name: value for name, value in filters.given.items() if name != "after"},
        chips=filters.chips(),
        total=total,
        is_least=listed.is_least,
        suggested=max(1, min(total, visitor_of(request).budget or USUAL_BUDGET)),
        most=MAX_SCENES_CHOSEN,
    )


@router.post("/selections")
async def make_selection(request: Request) -> Response:
    """Store a selection of the best distinct scenes, or of those that pass filters."""
    form = await request.form()
    fields = {name: value for name, value in form.items() if isinstance(value, str)}
    return await run_in_threadpool(_made, request, defaultdict(str, fields))


def _made(request: Request, form: defaultdict[str, str]) -> Response:
    need_token(request, form["token"])
    budget, name = form["budget"].strip(), form["name"].strip()
    if not (budget.isascii() and budget.isdecimal() and 0 < int(budget[:12]) < 10**9):
        raise UsageError("a selection has a budget: the number of scenes it may take, at least 1")
    if form["how"] not in ("best", "filters"):
        raise UsageError("a selection takes the best distinct scenes, or those that pass filters")
    source, count = source_of(request), int(budget)
    wanted = None
    if form["how"] == "filters":
        wanted = _that_pass(request, source, Filters.of(form), min(count, MAX_SCENES_CHOSEN))
    made = source.select(budget=count, name=name or None, scenes=wanted)
    if wants_json(request):
        return JSONResponse(made.model_dump(mode="json"))
    return RedirectResponse(f"/selection?name={quote(made.name, safe='')}", status_code=303)


def _that_pass(request: Request, source: Reader, filters: Filters, most: int) -> list[str]:
    """Return the ids of the first scenes that pass the filters.

    Raises:
        UsageError: If none does.
    """
    found: list[str] = []
    after = ""
    while len(found) < most:
        asked = filters.request(
            reviewer=visitor_of(request).reviewer,
            now_s=time.clock_gettime(time.CLOCK_REALTIME),
            most=min(MAX_PAGE, most - len(found)),
            after=after,
        )
        page = source.scenes(asked)
        found += [row.scene_id for row in page.rows]
        after = page.next
        if not after:
            break
    if not found:
        raise UsageError("no current scene passes these filters: there is nothing to select")
    return found


@router.get("/selection")
def selection(request: Request) -> Response:
    """Answer with one selection, and the progress of its reviewers."""
    source, found = source_of(request), _named(request)
    begin = _begin(request.query_params.get("from", ""))
    agreement = progress_of(request).of(source, found.name)
    visitor = visitor_of(request)
    return render(
        request,
        "selection.html",
        section="selections",
        selection=found,
        rows=found.scenes[begin : begin + PAGE],
        begin=begin,
        page=PAGE,
        pace=agreement.pace,
        scenes_judged=agreement.scenes,
        mine=summary(agreement, reviewer=visitor.reviewer, budget=0),
        progress=summary(agreement, reviewer=visitor.reviewer, budget=0)["text"],
        **export_context(request, found.name),
    )


@router.get("/data/selection")
def selection_lines(request: Request) -> Response:
    """Answer with the JSON lines of a selection, as `selection show --json` prints them."""
    found = _named(request)
    asked = ExportedRequest(selection=found.name, form="json-lines", scenes=len(found.scenes))
    source_of(request).exported(asked)
    lines = "".join(json_lines(found))
    return Response(
        lines,
        media_type="application/x-ndjson",
        headers={"content-disposition": 'attachment; filename="selection.jsonl"'},
    )


def _named(request: Request) -> Selection:
    name = request.query_params.get("name", "")
    if not name:
        raise UsageError("name the selection: /selection?name=…")
    return source_of(request).selection(name)


def _begin(text: str) -> int:
    if text and not (text.isascii() and text.isdecimal() and len(text) < 9):
        raise UsageError("from is the number of the first scene shown")
    return int(text or "0")
